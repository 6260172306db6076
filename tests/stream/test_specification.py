"""The format is what docs/bitstream.md and docs/decoding.md say: a reader written from them reads streams."""

from functools import cache
from pathlib import Path

import av
import numpy as np
import pytest

import encoder.__main__ as encoder
from dvc.keyframes import KeyFrameDecoder
from dvc.stream import StreamReader
from dvc.tracks import decode_points
from dvc.video import Frame, open_video
from tests.golden_streams import GOLDEN, Golden, source
from tests.reference import stream_reader as reader

BUFFERED = [golden for golden in GOLDEN if "buffered" in golden.forms]
START = b"\0\0\0\1"


@pytest.fixture(autouse=True)
def _remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "permutation", cache(reader.permutation))


@pytest.fixture(params=BUFFERED, ids=lambda golden: golden.name)
def golden(request: pytest.FixtureRequest) -> Golden:
    """Each of the buffered streams."""
    found: Golden = request.param
    return found


def padded_blocks(luma: np.ndarray) -> list[list[list[int]]]:
    """Return the 4x4 blocks of a frame in raster order, sides continued."""
    height, width = luma.shape
    whole = np.pad(luma, ((0, -height % 4), (0, -width % 4)), mode="edge").astype(int)
    return [
        whole[y : y + 4, x : x + 4].tolist()
        for y in range(0, whole.shape[0], 4)
        for x in range(0, whole.shape[1], 4)
    ]


def check_planes(config: dict, frame: reader.Frame) -> None:
    """Check and parity bits are those of the planes."""
    for bits, check in zip(frame.planes, frame.checks, strict=True):
        assert reader.check_bits(bits) == check
    plane = len(frame.planes) // 2
    for code, parities in enumerate(frame.parities):
        if config["coder"] == "turbo":
            expected = reader.turbo_parities(frame.planes[plane], config["seed"])
        else:
            expected = reader.cascade_parities(frame.planes[plane], config["seed"], code)
        assert parities[plane] == expected


def check_bins(config: dict, frame: reader.Frame, original: Frame) -> None:
    """Coefficients lie in the bins that the planes tell."""
    coefficients = [reader.transform(block) for block in padded_blocks(original.luma)]
    first = 0
    for band, count in enumerate(frame.counts):
        for block, bits in enumerate(zip(*frame.planes[first : first + count], strict=True)):
            number = int("".join(map(str, bits)), 2)
            low, high = reader.interval(config, frame, band, number)
            assert low - 1e-9 <= coefficients[block][band] <= high + 1e-9
        first += count


def test_planes_are_those_of_the_frames(golden: Golden, tmp_path_factory: pytest.TempPathFactory) -> None:
    """All bits are found, and stand for what the frames are made of."""
    config, groups = reader.read_stream(golden.path("buffered").read_bytes())
    with open_video(source(golden, tmp_path_factory.mktemp("clip"))) as video:
        originals = list(video)
    assert sum(group.num_frames for group in groups) == len(originals)
    index, num_checked = 0, 0
    for group in groups:
        for number, payload in enumerate(group.wyner_ziv):
            frame = reader.read_frame(config, payload)
            if frame.planes and num_checked < 2:
                check_planes(config, frame)
                check_bins(config, frame, originals[index + number])
                num_checked += 1
        index += group.num_frames
    assert num_checked


def test_key_frames_are_h264_intra(golden: Golden) -> None:
    """With headers and start codes put back any decoder reads them; what fills up the sides is cut off."""
    config, groups = reader.read_stream(golden.path("buffered").read_bytes())
    sets, height, width = config["parameter_sets"], config["height"], config["width"]
    end = 1 + sets[0]
    head = START + b"\x67" + sets[1:end] + START + b"\x68" + sets[end:]
    decoder = KeyFrameDecoder(width, height, sets, luma_only=config["luma_only"])
    for data in filter(None, (group.key for group in groups)):
        context = av.CodecContext.create("h264", "r")
        (picture,) = [*context.decode(av.Packet(head + START + b"\x65" + data)), *context.decode(None)]
        assert (picture.width % 16, picture.height % 16) == (0, 0)
        luma = np.frombuffer(picture.planes[0], np.uint8).reshape(picture.height, -1)[:height, :width]
        np.testing.assert_array_equal(luma, decoder.decode(data).luma)


def test_syndromes_are_those_of_the_frames(tmp_path: Path) -> None:
    """What is sent without feedback follows from the planes of the originals."""
    (golden,) = (golden for golden in GOLDEN if "no-feedback" in golden.forms)
    clip, stream = source(golden, tmp_path), tmp_path / "fine.dvc"
    assert encoder.main([str(clip), str(stream), *golden.coding.split(), "--qp", "22", "--quiet"]) == 0
    config, groups = reader.read_stream(stream.read_bytes())
    with open_video(clip) as video:
        originals = list(video)
    index, num_checked = 0, 0
    for group in groups:
        for number, payload in enumerate(group.wyner_ziv):
            frame = reader.read_sent_frame(config, payload)
            planes = planes_of(config, frame, originals[index + number])
            for share, (check, syndrome), bands in zip(
                (0.8, 0.5), frame.blocks, (range(1), range(1, 16)), strict=True
            ):
                if any(syndrome):
                    sent = {
                        sum(frame.counts[:band]) + k: planes[band][k]
                        for band in bands
                        for k in range(frame.sent[band])
                    }
                    checks = [bit for bits in sent.values() for bit in reader.check_bits(bits)]
                    assert reader.check_bits(checks) == check
                    place = config["seed"], len(syndrome), share, sum(frame.counts)
                    assert reader.syndrome(sent, *place) == syndrome
                    num_checked += 1
        index += group.num_frames
    assert num_checked > 2


def planes_of(config: dict, frame: reader.SentFrame, original: Frame) -> list[list[list[int]]]:
    """Return the planes of each band of a frame with embedded quantisers."""
    coefficients = [reader.transform(block) for block in padded_blocks(original.luma)]
    found = []
    for band, (count, step) in enumerate(zip(frame.counts, frame.steps, strict=True)):
        assert step is not None
        origin = 4 ** -(-count // 2) / 3 if band else 0.0
        numbers = [int(np.floor(each[band] / step + origin)) for each in coefficients]
        found.append([[number >> k & 1 for number in numbers] for k in reversed(range(count))])
    return found


def test_points_are_read() -> None:
    """As the decoder reads them."""
    (golden,) = (golden for golden in GOLDEN if golden.name == "3d-td-luma")
    config, groups = reader.read_stream(golden.path("buffered").read_bytes())
    with StreamReader(golden.path("buffered")) as stream:
        other = stream.config
    num_points = 0
    for group in groups:
        found = reader.read_points(config, group.tracks, len(group.wyner_ziv))
        expected = decode_points(group.tracks, len(group.wyner_ziv), other).frames
        scale = 2.0 ** config["subpixel_bits"]
        for own, others in zip(found, expected, strict=True):
            np.testing.assert_array_equal(np.reshape(own, (-1, 2)) / scale, others)
            num_points += len(own)
    assert num_points > 100
