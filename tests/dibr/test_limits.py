"""A few bytes cannot make a decoder spend much: it refuses, or what they say is cheap."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dvc.dibr.depth_image import depth_image_stream as depth_image
from dvc.dibr.depth_image import piece_stream as layered
from dvc.dibr.depth_image.depth_image_stream import DepthImageStream, DepthScale, PlaneCode
from dvc.dibr.depth_image.scene_pieces import Kind
from dvc.dibr.dibr_streams import FREE_PIXELS, MAX_MIB, check_extent
from dvc.dibr.view_stream import Header, PairLayer, Stream, decode, decode_stream, encode_stream
from dvc.entropy import RangeCoder
from dvc.errors import BitstreamError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.images import _kernels as kernels
from dvc.images import chain_code, picture_codec
from dvc.images import zerotree_coder as coder
from dvc.images.chain_code import EdgeCode
from dvc.images.picture_codec import PictureHeader
from dvc.layers.canvas import Canvas, Frame

LABELS = DisparityLabels(0.0, 1.0, 4)


def _bomb(references: int, side: int, layers: int = 1) -> bytes:
    """A stream of colour pictures that holds nothing but its header and empty layers."""
    views = tuple(LatticePosition(float(m), 0.0) for m in range(references))
    header = Header((side, side), "l", LABELS, tuple(range(references)), layers, views)
    pair = PairLayer(PictureHeader(6, 1, True).to_bytes(), b"")
    return encode_stream(header, [(pair,) * references] * layers)


_DECODE = """
import sys
from pathlib import Path
from dvc.dibr.__main__ import main
from dvc.memory import peak_resident_bytes, resident_bytes
small, *arguments = sys.argv[1:]
assert main(["decode", small, "--out", small + "-out", "--quiet"]) == 0  # loads libraries and kernels
Path("/proc/self/clear_refs").write_text("5")  # forgets the peak
before = resident_bytes()
status = main(["decode", *arguments])
print(peak_resident_bytes() - before)
sys.exit(status)
"""


def _decoded(path: Path) -> tuple[int, str, float]:
    """Exit status, what is on standard error, and the growth of memory in MiB of a decoder."""
    small = path.parent / "small.dibr"
    small.write_bytes(_bomb(1, 8))
    arguments = map(str, (small, path, "--out", path.parent / "out", "--quiet"))
    command = [sys.executable, "-c", _DECODE, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr, int(done.stdout) / 2**20


@pytest.mark.parametrize(("references", "side", "length"), [(1, 4096, 45), (20, 512, 311)])
def test_small_bombs_are_refused_in_one_line(references, side, length, tmp_path):
    bomb = tmp_path / "bomb.dibr"
    bomb.write_bytes(_bomb(references, side))
    assert bomb.stat().st_size == length
    status, said, growth = _decoded(bomb)
    assert (status, said.count("\n")) == (2, 1), said
    assert "--max-memory" in said
    assert growth < 10.0
    assert not (tmp_path / "out").exists()


def test_the_largest_picture_of_no_data_that_is_accepted_is_cheap(tmp_path):
    bomb = tmp_path / "bomb.dibr"
    bomb.write_bytes(_bomb(1, 880))
    status, said, growth = _decoded(bomb)
    assert (status, said) == (0, "")
    assert growth < 150.0


def test_an_option_raises_the_limit():
    data = _bomb(20, 512)
    with pytest.raises(BitstreamError, match="too few"):
        decode_stream(data)
    with pytest.raises(BitstreamError, match="MiB, more than 100"):
        decode_stream(data, 100)
    assert decode_stream(data, MAX_MIB).damage is None


def test_each_layer_and_reference_counts():
    side = int((FREE_PIXELS // 8) ** 0.5)
    assert decode_stream(_bomb(2, side, 4)).damage is None
    for references, layers in ((2, 6), (3, 4)):
        with pytest.raises(BitstreamError, match="too few"):
            decode_stream(_bomb(references, side, layers))


def test_pictures_worth_their_bytes_are_accepted():
    check_extent(3840 * 2160, 3840 * 2160, 3840 * 2160, 10_000, None)  # 0.01 bit per pixel
    with pytest.raises(BitstreamError, match="more than 2048"):
        check_extent(2**24, 2**24, 2**24, 10**9, None)


def test_depth_maps_are_refused_alike():
    plane = PlaneCode(PictureHeader(5, 1), 1, b"")
    stream = DepthImageStream((2048, 2048), DepthScale(0.0, 1.0), b"", EdgeCode.ADAPTIVE, plane, plane)
    data = depth_image.encode_stream(stream)
    with pytest.raises(BitstreamError, match="too few"):
        depth_image.decode_stream(data)
    assert depth_image.decode_stream(data, MAX_MIB).shape == (2048, 2048)


@pytest.mark.parametrize("kind", list(Kind))
def test_pieces_are_refused_alike(kind):
    canvas = Canvas((2048, 2048), Frame(0, 0, 2048, 2048), LABELS, 1.0, "a", 2)
    data = layered.encode_stream(canvas, kind, [Frame(0, 0, 0, 0)], [None])
    with pytest.raises(BitstreamError, match="too few"):
        layered.decode_stream(data)
    assert layered.decode_stream(data, MAX_MIB).rectangles == (Frame(0, 0, 0, 0),)


def test_more_chains_than_their_bytes_can_hold_are_refused():
    coder = RangeCoder.writer()
    for bound, value in ((2**24, 2**24 - 1), (32, 1)):
        coder.uniform(bound, value)
    with pytest.raises(BitstreamError, match="damaged"):
        chain_code.decode(coder.to_bytes(), (64, 64), EdgeCode.FIXED)


@pytest.mark.parametrize("shape", [(1, 1), (13, 40), (64, 64)])
@pytest.mark.parametrize("num_levels", [0, 1, 6])
def test_no_data_decode_to_what_coefficients_of_zero_give(shape, num_levels):
    nothing = picture_codec.encode(np.full(shape, 128.0), num_levels=num_levels)
    assert (nothing.header.num_bit_planes, nothing.data) == (0, b"")
    header = replace(nothing.header, num_bit_planes=3)
    for skipped in range(num_levels + 1):
        found = picture_codec.decode(header, b"", shape, skipped)
        forest = picture_codec._forest(shape, header.num_levels, header.colour, None)
        known = coder.decode(forest, b"", header.num_bit_planes, header.adaptive)
        assert not known.values.any()
        assert np.array_equal(found.planes, np.full_like(found.planes, 128.0))
        expected = picture_codec.significance_maps(forest.bands, known, shape, len(found.significance))
        assert all(map(np.array_equal, found.significance, expected))


@pytest.fixture
def decisions(monkeypatch):
    """How many decisions each run of the coder of pictures took."""
    runs, new_run = [], coder._new_run

    def keep(*arguments):
        runs.append(new_run(*arguments))
        return runs[-1]

    monkeypatch.setattr(coder, "_new_run", keep)
    return lambda: [int(run.fields[kernels.DECISIONS]) for run in runs]


def test_what_cannot_have_been_written_ends_decoding_at_once(decisions):
    data = np.random.default_rng(1).bytes(200_000)
    with pytest.raises(BitstreamError, match="damaged"):
        picture_codec.decode(PictureHeader(6, 12, True), data, (512, 512))
    assert decisions()[0] < 10_000


def test_bytes_stand_for_a_number_of_decisions(decisions):
    data = bytes(100)
    with pytest.raises(BitstreamError, match="damaged"):
        picture_codec.decode(PictureHeader(0, 30, False), data, (600, 600))
    assert decisions() == [kernels.FREE_DECISIONS + kernels.DECISIONS_PER_BYTE * len(data) + 1]


def test_what_is_written_can_be_read(decisions):
    code = picture_codec.encode(np.full((600, 600), 90.0), num_levels=0)
    assert kernels.FREE_DECISIONS // 2 < decisions()[0] < kernels.FREE_DECISIONS
    for length in range(len(code.data), 0, -3):
        assert (
            picture_codec.decode(code.header, code.data[:length], code.shape).planes.shape[1:] == code.shape
        )
    assert max(decisions()[1:]) < kernels.FREE_DECISIONS


def test_an_empty_layer_leaves_the_picture_as_it_is():
    stream = decode_stream(_bomb(1, 16, 3))
    assert isinstance(stream, Stream)
    decoded = decode(stream)
    assert (decoded.num_layers, decoded.damage) == (3, None)
    assert (decoded.pairs[0].picture == 128).all()
