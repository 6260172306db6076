"""Key frames: H.264 pictures of any size, alone; `tests/test_key_chains.py` predicts them."""

import io
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import BitstreamError, VideoError
from dvc.keyframes import CHROMA_QP_OFFSET, KeyFrameDecoder, KeyFrameEncoder, Qp
from dvc.metrics import psnr_db
from dvc.video import Frame, chroma_shape, open_video
from dvc.video.pixels import picture_from_frame
from tests.clips import same_frame
from tests.key_pictures import coded_qps

MakeFrames = Callable[..., list[Frame]]

SIZES = [(48, 32), (33, 25), (1, 1), (2, 3), (17, 1), (16, 40)]


def noise_frame(width: int, height: int, *, grey: bool = False) -> Frame:
    """Return a picture that no prediction helps with."""
    rng = np.random.default_rng(width * 1000 + height)
    shapes = [(height, width), chroma_shape(height, width), chroma_shape(height, width)]
    luma, cb, cr = (rng.integers(0, 256, shape, dtype=np.uint8) for shape in shapes)
    return Frame(luma, None if grey else (cb, cr))


def expected_planes(frame: Frame, luma_only: bool) -> Frame:
    """Return what a lossless round trip gives."""
    return frame.without_chroma() if luma_only else frame.with_chroma()


def decoder_of(size: tuple[int, int], encoder: KeyFrameEncoder, luma_only: bool = False) -> KeyFrameDecoder:
    return KeyFrameDecoder(*size, encoder.parameter_sets, luma_only=luma_only)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("luma_only", "qp"), [(False, 22), (True, 40), (False, "lossless")])
def test_pictures_decode_in_any_order(
    moving_frames: MakeFrames, size: tuple[int, int], luma_only: bool, qp: Qp
) -> None:
    """Each alone, in a fresh decoder as in one that has decoded others."""
    frames = moving_frames(4, *size)
    encoder = KeyFrameEncoder(*size, qp, luma_only=luma_only)
    coded = [encoder.encode(frame) for frame in frames]
    assert not any(picture.predicted for picture in coded)
    used = decoder_of(size, encoder, luma_only)
    for index in (2, 0, 3, 1):
        got = decoder_of(size, encoder, luma_only).decode(coded[index].data)
        assert (got.width, got.height) == size
        assert (got.chroma is None) == luma_only
        assert same_frame(got, used.decode(coded[index].data))
        if qp == "lossless":
            assert same_frame(got, expected_planes(frames[index], luma_only))
        else:
            floor_db = 24 if qp == 40 else 38 if min(size) > 3 else 30
            assert psnr_db(got.luma, frames[index].luma) > floor_db


@pytest.mark.parametrize("luma_only", [False, True])
@given(width=st.integers(1, 50), height=st.integers(1, 50))
def test_lossless_is_the_source_itself(luma_only: bool, width: int, height: int) -> None:
    """Any size and any samples survive without loss."""
    frame = noise_frame(width, height)
    encoder = KeyFrameEncoder(width, height, "lossless", luma_only=luma_only)
    got = decoder_of((width, height), encoder, luma_only).decode(encoder.encode(frame).data)
    assert same_frame(got, expected_planes(frame, luma_only))


@pytest.mark.parametrize("qp", [1, 25, 40, 51])
def test_qp_is_exactly_that_of_all_macroblocks(moving_frames: MakeFrames, qp: int) -> None:
    """No rate control, no adaptation and no factor for I frames touch it; each picture may have another."""
    encoder = KeyFrameEncoder(48, 32, qp)
    asked = (None, None, 51, 17, 1, 30, None)
    frames = moving_frames(len(asked), 48, 32)
    coded = [encoder.encode(frame, other) for frame, other in zip(frames, asked, strict=True)]
    assert coded_qps(encoder.parameter_sets, coded) == [{qp if other is None else other} for other in asked]
    decoder = decoder_of((48, 32), encoder)
    quality_db = [
        psnr_db(decoder.decode(picture.data).luma, frame.luma)
        for picture, frame in zip(coded, frames, strict=True)
    ]
    assert quality_db[4] > 50.0 > quality_db[3] > quality_db[5] > quality_db[2]


def test_large_pictures_work() -> None:
    """A picture of 4096x2304 pixels passes."""
    rows, columns = np.mgrid[:2304, :4096]
    frame = Frame(((rows + columns) // 32 % 256).astype(np.uint8))
    encoder = KeyFrameEncoder(4096, 2304, 40, luma_only=True)
    decoder = decoder_of((4096, 2304), encoder, luma_only=True)
    assert psnr_db(decoder.decode(encoder.encode(frame).data).luma, frame.luma) > 35


def test_grey_frames_count_as_neutral_in_colour(moving_frames: MakeFrames) -> None:
    """A colour encoder takes a frame without chroma for one with chroma 128."""
    frame = moving_frames(1, 20, 12, grey=True)[0]
    encoder = KeyFrameEncoder(20, 12, "lossless")
    got = decoder_of((20, 12), encoder).decode(encoder.encode(frame).data)
    assert same_frame(got, frame.with_chroma())


def test_coding_is_repeatable(moving_frames: MakeFrames) -> None:
    """Two encoders give the same bytes; the parameter sets are a dozen."""
    frames = moving_frames(3, 64, 48)
    first, second = (KeyFrameEncoder(64, 48, 30) for _ in range(2))
    assert [first.encode(f) for f in frames] == [second.encode(f) for f in frames]
    assert first.parameter_sets == second.parameter_sets
    assert len(first.parameter_sets) <= 14


@pytest.mark.parametrize("luma_only", [False, True])
def test_fuzzed_pictures_raise_only_bitstream_error(moving_frames: MakeFrames, luma_only: bool) -> None:
    """Flipped bits and cuts are found, or give a whole picture; the decoder goes on with the next one."""
    frame = moving_frames(1, 64, 48)[0]
    encoder = KeyFrameEncoder(64, 48, 30, luma_only=luma_only)
    data = encoder.encode(frame).data
    decoder = decoder_of((64, 48), encoder, luma_only)
    right = decoder.decode(data)
    rng = np.random.default_rng(0)
    found = 0
    for trial in range(400):
        damaged = bytearray(data)
        if trial % 4:
            damaged[rng.integers(len(data))] ^= 1 << rng.integers(8)
        else:
            del damaged[rng.integers(len(data)) :]
        try:
            got = decoder.decode(bytes(damaged))
        except BitstreamError:
            found += 1
        else:
            assert got.luma.shape == (48, 64)
        if trial % 20 == 0:
            assert same_frame(decoder.decode(data), right)
    assert found > 300


@given(data=st.binary(max_size=300), seed=st.integers(0, 3))
def test_random_bytes_raise_only_bitstream_error(data: bytes, seed: int) -> None:
    """Noise is refused as picture and as parameter sets."""
    encoder = KeyFrameEncoder(32, 32, 30, luma_only=seed % 2 == 0)
    decoder = decoder_of((32, 32), encoder)
    with pytest.raises(BitstreamError):
        decoder.decode(data)
    picture = encoder.encode(noise_frame(32, 32)).data
    with suppress(BitstreamError):
        KeyFrameDecoder(32, 32, data).decode(picture)


@given(position=st.integers(0, 10), value=st.integers(0, 255))
def test_damaged_parameter_sets_raise_only_bitstream_error(position: int, value: int) -> None:
    """A changed byte is refused at once or with the picture, or gives a picture of the right size."""
    encoder = KeyFrameEncoder(32, 32, 30)
    picture = encoder.encode(noise_frame(32, 32)).data
    sets = bytearray(encoder.parameter_sets)
    sets[position] = value
    try:
        got = KeyFrameDecoder(32, 32, bytes(sets)).decode(picture)
    except BitstreamError:
        return
    assert got.luma.shape == (32, 32)


def test_pictures_of_another_size_are_refused(moving_frames: MakeFrames) -> None:
    """A decoder for small pictures does not make room for a large one."""
    encoder = KeyFrameEncoder(320, 240, 40)
    data = encoder.encode(moving_frames(1, 320, 240)[0]).data
    for size in ((32, 32), (336, 240), (304, 240)):
        with pytest.raises(BitstreamError, match="key frame"):
            KeyFrameDecoder(*size, encoder.parameter_sets).decode(data)


@pytest.mark.parametrize("qp", [0, 52, -1, "best", 25.0])
def test_unknown_qp_is_refused(qp: object) -> None:
    """Only 1 to 51 and "lossless" are quantization parameters."""
    with pytest.raises(ValueError, match="`qp` must be 1 to 51 or 'lossless'"):
        KeyFrameEncoder(16, 16, qp)  # type: ignore[arg-type]


def test_wrong_sizes_are_refused(moving_frames: MakeFrames) -> None:
    """Giant pictures are refused before they are allocated, and frames must have the encoder's size."""
    with pytest.raises(VideoError, match="not supported"):
        KeyFrameEncoder(40000, 16, 30)
    with pytest.raises(VideoError, match="not supported"):
        KeyFrameDecoder(40000, 16, b"\x05" * 12)
    with pytest.raises(ValueError, match="pixels"):
        KeyFrameEncoder(16, 16, 30).encode(moving_frames(1, 16, 18)[0])


def x264_file_bytes(frames: list[Frame], qp: int, pixel_format: str) -> int:
    """Return the size of a plain all-intra H.264 file with the same settings."""
    file = io.BytesIO()
    with av.open(file, "w", format="h264") as container:
        parameters = f"keyint=1:psy=0:ipratio=1:threads=1:chroma-qp-offset={CHROMA_QP_OFFSET}"
        options = {"preset": "medium", "qp": str(qp), "x264-params": parameters}
        stream = container.add_stream("libx264", rate=15, options=options)
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, pixel_format
        for index, frame in enumerate(frames):
            picture = picture_from_frame(frame, pixel_format)
            picture.pts = index
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return len(file.getvalue())


@pytest.mark.parametrize("luma_only", [False, True])
@pytest.mark.parametrize("qp", [25, 40])
def test_real_frames_cost_less_than_in_a_plain_file(shared_sequences: Path, qp: int, luma_only: bool) -> None:
    """Records and parameter sets together are smaller than the file that x264 writes."""
    with open_video(shared_sequences / "foreman_qcif15.mkv", num_frames=20) as reader:
        frames = list(reader)
    encoder = KeyFrameEncoder(176, 144, qp, luma_only=luma_only)
    num_bytes = len(encoder.parameter_sets) + sum(len(encoder.encode(frame).data) for frame in frames)
    plain_bytes = x264_file_bytes(frames, qp, "gray" if luma_only else "yuv420p")
    assert num_bytes < plain_bytes - 20 * len(frames)
