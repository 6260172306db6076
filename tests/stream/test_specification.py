"""A reader that was written from the bitstream and decoding pages of docs/spec reads frozen streams."""

from functools import cache
from pathlib import Path

import av
import numpy as np
import pytest

from dvc.config import CodecConfig, VideoConfig, codec_config
from dvc.keyframes import KeyFrameDecoder
from dvc.slepian_wolf import CRC_BITS, crc_words, plane_coder
from dvc.stream import StreamReader
from dvc.tracks import PointTracks, decode_points, decode_tracks, encode_tracks
from dvc.video import Frame, open_video
from tests.golden_streams import GOLDEN, Golden, source
from tests.reference import stream_reader as reader
from tests.reference import track_reader

BUFFERED = [golden for golden in GOLDEN if "buffered" in golden.forms]
KINDS = ["2d-odd-luma", "2d-odd-colour", "2d-classical", "2d-qp", "2d-time-stamps"]
KINDS += ["3d-te-odd", "3d-te-predicted"]
START = b"\0\0\0\1"


@pytest.fixture(autouse=True)
def _remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "permutation", cache(reader.permutation))


@cache
def golden_of(name: str) -> Golden:
    return next(golden for golden in GOLDEN if golden.name == name)


def groups_of(name: str) -> tuple[dict, list, CodecConfig]:
    """Return fields and groups of a frozen stream as the documents describe them, and its configuration."""
    path = golden_of(name).path("buffered")
    with StreamReader(path) as stream:
        return *reader.read_stream(path.read_bytes()), stream.config


def padded_blocks(luma: np.ndarray) -> list[list[list[int]]]:
    """Return the 4x4 blocks of a frame in raster order, sides continued."""
    height, width = luma.shape
    whole = np.pad(luma, ((0, -height % 4), (0, -width % 4)), mode="edge").astype(int)
    return [
        whole[y : y + 4, x : x + 4].tolist()
        for y in range(0, whole.shape[0], 4)
        for x in range(0, whole.shape[1], 4)
    ]


def check_planes(config: CodecConfig, frame: reader.Frame) -> None:
    """Check and parity bits that are made of a plane are those of the documents."""
    bits, coder = frame.planes[len(frame.planes) // 2], plane_coder(config)
    words, parity = np.array(bits, np.uint64), np.empty(len(bits), np.uint64)
    assert reader.check_bits(bits) == crc_words(words, CRC_BITS).tolist()
    for code in range(coder.num_codes):
        if config.coder.name == "turbo":
            expected = reader.turbo_parities(bits, config.seed)
        else:
            expected = reader.cascade_parities(bits, config.seed, code)
        coder.encode(code, words, parity)
        assert parity.tolist() == expected


def check_bins(config: dict, frame: reader.Frame, original: Frame) -> None:
    coefficients = [reader.transform(block) for block in padded_blocks(original.luma)]
    first = 0
    for band, count in enumerate(frame.counts):
        for block, bits in enumerate(zip(*frame.planes[first : first + count], strict=True)):
            number = int("".join(map(str, bits)), 2)
            low, high = reader.interval(config, frame, band, number)
            assert low - 1e-9 <= coefficients[block][band] <= high + 1e-9
        first += count


@pytest.mark.parametrize("name", KINDS)
def test_planes_are_those_of_the_frames(name: str, tmp_path: Path) -> None:
    config, groups, read_config = groups_of(name)
    with open_video(source(golden_of(name), tmp_path)) as video:
        originals = list(video)
    assert sum(group.num_frames for group in groups) == len(originals)
    index, num_checked = 0, 0
    for group in groups:
        for number, payload in enumerate(group.wyner_ziv):
            frame = reader.read_frame(config, payload)
            if frame.planes and num_checked < 2:
                check_planes(read_config, frame)
                check_bins(config, frame, originals[index + number])
                num_checked += 1
        index += group.num_frames
    assert num_checked


@pytest.mark.parametrize("golden", BUFFERED, ids=lambda golden: golden.name)
def test_key_frames_are_h264(golden: Golden) -> None:
    """With headers and start codes added any decoder reads them; padding is cropped."""
    config, groups = reader.read_stream(golden.path("buffered").read_bytes())
    sets, height, width = config["parameter_sets"], config["height"], config["width"]
    end = 1 + sets[0]
    head = START + b"\x67" + sets[1:end] + START + b"\x68" + sets[end:]
    decoder = KeyFrameDecoder(width, height, sets, luma_only=config["luma_only"])
    chains = reader.key_chains(config, groups)
    assert any(len(chain) > 1 for chain in chains) == golden.predicted_keys
    for chain in chains:
        context, pictures = av.CodecContext.create("h264", "r"), []
        for unit in chain:
            pictures += context.decode(av.Packet(head + START + unit))
        pictures += context.decode(None)
        for unit, picture in zip(chain, pictures, strict=True):
            assert (picture.width % 16, picture.height % 16) == (0, 0)
            luma = np.frombuffer(picture.planes[0], np.uint8).reshape(picture.height, -1)[:height, :width]
            own = decoder.decode(unit[1:], predicted=unit is not chain[0])
            np.testing.assert_array_equal(luma, own.luma)


def test_nothing_is_sent_of_frames_without_feedback() -> None:
    config, groups = reader.read_stream(golden_of("3d-te").path("no-feedback").read_bytes())
    assert any(group.wyner_ziv for group in groups)
    for group in groups:
        assert not any(group.wyner_ziv)
        if group.tracks:
            assert any(tracks_of(config, group.tracks, group.num_frames + 1))


def test_points_are_read() -> None:
    config, groups, other = groups_of("3d-td-luma")
    num_points = 0
    for group in groups:
        found = reader.read_points(config, group.tracks, len(group.wyner_ziv))
        expected = decode_points(group.tracks, len(group.wyner_ziv), other).frames
        scale = 2.0 ** config["subpixel_bits"]
        for own, others in zip(found, expected, strict=True):
            np.testing.assert_array_equal(np.reshape(own, (-1, 2)) / scale, others)
            num_points += len(own)
    assert num_points > 100


FORWARD_LOSSES = (1.0, 4.0), (1.0, 16.0), (1.0, 26.0)
BACKWARD_LOSSES = (1.0, 4.0), (1.0, 9.0), (1.0, 9.0)


def tracks_of(config: dict, data: bytes, num_instants: int) -> tuple[list, list]:
    """Read the tracks of a group: those that begin with it, and those that go back from its end."""
    coder = reader.RangeReader(data)
    curves, sides, bits = track_reader.Curves(coder), reader.sides(config), config["subpixel_bits"]
    counts = [coder.number(config["num_points"] + 1) for _ in range(2)]
    found: list[list] = []
    given: list = []
    for count, losses in zip(counts, (FORWARD_LOSSES, BACKWARD_LOSSES), strict=True):
        tracks: list = []
        if count:
            taken = [track[0] for track in given]
            first = track_reader.read_first(coder, count, taken, sides, reader.read_point_set)
            direction = track_reader.Direction(coder, curves, sides, bits, [*map(list, losses)])
            tracks = direction.read(given, first, num_instants)
        found.append(tracks)
        given = [track[::-1] for track in tracks if track[-1] is not None]
    return found[0], found[1]


def positions(tracks: list, scale: float) -> np.ndarray:
    lost = (np.nan, np.nan)
    return np.array([[lost if point is None else point for point in track] for track in tracks]) / scale


@pytest.mark.parametrize("name", ["3d-te-colour", "3d-te-odd", "3d-te-predicted"])
def test_tracks_are_read(name: str) -> None:
    config, groups, other = groups_of(name)
    scale, num_tracks = 2.0 ** config["subpixel_bits"], 0
    for group in groups:
        if not group.tracks:
            continue
        forward, backward = tracks_of(config, group.tracks, group.num_frames + 1)
        expected = decode_tracks(group.tracks, group.num_frames + 1, other)
        together = [*forward, *(track[::-1] for track in backward)]
        np.testing.assert_array_equal(positions(together, scale), expected.positions)
        num_tracks += len(together)
    assert num_tracks > 20


@pytest.mark.parametrize(("seed", "jitter"), [(1, 0.3), (3, 60.0)])
def test_tracks_of_any_motion_are_read(seed: int, jitter: float) -> None:
    config = codec_config(VideoConfig(96, 80, 25, 1), "3d-te")
    rng, num_instants = np.random.default_rng(seed), 6
    tracks = []
    for number in range(24):
        steps = rng.normal(0, jitter, (num_instants, 2)) + np.array([2.0, 0.5])
        moved = np.clip(rng.uniform(0, (95, 79)) + np.cumsum(steps, axis=0), 0, (95, 79))
        moved[rng.integers(2, 2 * num_instants) :] = np.nan
        tracks.append(np.round(2 * (moved[::-1] if number >= 18 else moved)) / 2)
    payload = encode_tracks(PointTracks(np.array(tracks), 6), config)
    expected = decode_tracks(payload, num_instants, config)
    fields = {"width": 96, "height": 80, "num_points": config.tracks.num_points, "subpixel_bits": 1}
    forward, backward = tracks_of(fields, payload, num_instants)
    assert (len(forward), len(backward)) == (18, 6)
    together = [*forward, *(track[::-1] for track in backward)]
    np.testing.assert_array_equal(positions(together, 2.0), expected.positions)
