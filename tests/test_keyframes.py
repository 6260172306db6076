"""Key pictures of any size, intra or predicted in chains from those before, up to the next IDR picture."""

import io
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import BitstreamError, VideoError
from dvc.keyframes import CHROMA_QP_OFFSET, KeyFrameDecoder, KeyFrameEncoder, KeyPicture, Qp
from dvc.metrics import psnr_db
from dvc.video import Frame, chroma_shape, open_video
from dvc.video.pixels import picture_from_frame
from tests.clips import moving_texture, same_frame, same_frames
from tests.key_pictures import SliceHead, Sps, coded_qps, join_sets, slice_head, split_sets, with_head

MakeFrames = Callable[..., list[Frame]]

SIZE = WIDTH, HEIGHT = 64, 48
NUM_FRAMES = 20  # more than frame numbers of four bits count
MISSING = "key frame: its reference picture is missing"
FRAMES = moving_texture(NUM_FRAMES, HEIGHT, WIDTH, (0.5, 1.0))


def coded(
    encoder: KeyFrameEncoder, frames: Sequence[Frame], begins: Sequence[int] = (0,)
) -> list[KeyPicture]:
    """Code pictures; some begin a chain."""
    return [encoder.encode(frame, begins_chain=number in begins) for number, frame in enumerate(frames)]


def decoded(decoder: KeyFrameDecoder, pictures: Sequence[KeyPicture]) -> list[Frame]:
    return [decoder.decode(picture.data, predicted=picture.predicted) for picture in pictures]


ENCODER = KeyFrameEncoder(*SIZE, 30, predicted=True)
CHAIN = coded(ENCODER, FRAMES, (0, 18))  # a long chain and a short one


def fresh_decoder() -> KeyFrameDecoder:
    return KeyFrameDecoder(*SIZE, ENCODER.parameter_sets)


RIGHT = decoded(fresh_decoder(), CHAIN)
INTRA_ENCODER = KeyFrameEncoder(*SIZE, 30)
INTRA = coded(INTRA_ENCODER, FRAMES)


def noise_frame(width: int, height: int, *, grey: bool = False) -> Frame:
    """Return a picture that no prediction helps with."""
    rng = np.random.default_rng(width * 1000 + height)
    shapes = [(height, width), chroma_shape(height, width), chroma_shape(height, width)]
    luma, cb, cr = (rng.integers(0, 256, shape, dtype=np.uint8) for shape in shapes)
    return Frame(luma, None if grey else (cb, cr))


def expected_planes(frame: Frame, luma_only: bool) -> Frame:
    """Return the result of a lossless round trip."""
    return frame.without_chroma() if luma_only else frame.with_chroma()


@pytest.mark.parametrize("size", [(48, 32), (33, 25), (1, 1), (2, 3), (17, 1), (16, 40)])
@pytest.mark.parametrize(
    ("luma_only", "qp"), [(False, 22), (True, 40), (False, "lossless"), (True, "lossless")]
)
@pytest.mark.parametrize("predicted", [False, True])
def test_pictures_of_any_size_come_back(
    moving_frames: MakeFrames, size: tuple[int, int], luma_only: bool, qp: Qp, predicted: bool
) -> None:
    """In colour or luma, without loss if requested; each chain decodes without those before it."""
    frames = moving_frames(6, *size)
    encoder = KeyFrameEncoder(*size, qp, luma_only=luma_only, predicted=predicted)
    begins = (0, 4) if predicted else range(6)
    pictures = coded(encoder, frames, begins)
    assert [not picture.predicted for picture in pictures] == [number in begins for number in range(6)]
    whole, last = (
        decoded(KeyFrameDecoder(*size, encoder.parameter_sets, luma_only=luma_only), part)
        for part in (pictures, pictures[4:])
    )
    assert same_frames(whole[4:], last)
    floor_db = 24 if qp == 40 else 38 if min(size) > 3 and not predicted else 29
    for original, got in zip(frames, whole, strict=True):
        assert (got.width, got.height, got.chroma is None) == (*size, luma_only)
        if qp == "lossless":
            assert same_frame(got, expected_planes(original, luma_only))
        else:
            assert psnr_db(original.luma, got.luma) > floor_db


def test_intra_pictures_decode_in_any_order() -> None:
    used = KeyFrameDecoder(*SIZE, INTRA_ENCODER.parameter_sets)
    for index in (2, 0, 3, 1):
        fresh = KeyFrameDecoder(*SIZE, INTRA_ENCODER.parameter_sets)
        assert same_frame(fresh.decode(INTRA[index].data), used.decode(INTRA[index].data))


@pytest.mark.parametrize("luma_only", [False, True])
@given(width=st.integers(1, 50), height=st.integers(1, 50))
def test_lossless_is_the_source_itself(luma_only: bool, width: int, height: int) -> None:
    frame = noise_frame(width, height)
    encoder = KeyFrameEncoder(width, height, "lossless", luma_only=luma_only)
    got = KeyFrameDecoder(width, height, encoder.parameter_sets, luma_only=luma_only).decode(
        encoder.encode(frame).data
    )
    assert same_frame(got, expected_planes(frame, luma_only))


@pytest.mark.parametrize("qp", [1, 25, 40, 51])
def test_qp_is_exactly_that_of_all_macroblocks(moving_frames: MakeFrames, qp: int) -> None:
    """No rate control, no adaptation and no factor for I frames changes it; each picture may have another."""
    encoder = KeyFrameEncoder(48, 32, qp)
    asked = (None, None, 51, 17, 1, 30, None)
    frames = moving_frames(len(asked), 48, 32)
    coded = [encoder.encode(frame, other) for frame, other in zip(frames, asked, strict=True)]
    assert coded_qps(encoder.parameter_sets, coded) == [{qp if other is None else other} for other in asked]
    decoder = KeyFrameDecoder(48, 32, encoder.parameter_sets)
    quality_db = [
        psnr_db(decoder.decode(picture.data).luma, frame.luma)
        for picture, frame in zip(coded, frames, strict=True)
    ]
    assert quality_db[4] > 50.0 > quality_db[3] > quality_db[5] > quality_db[2]


def test_large_pictures_work() -> None:
    rows, columns = np.mgrid[:2304, :4096]
    frame = Frame(((rows + columns) // 32 % 256).astype(np.uint8))
    encoder = KeyFrameEncoder(4096, 2304, 40, luma_only=True)
    decoder = KeyFrameDecoder(4096, 2304, encoder.parameter_sets, luma_only=True)
    assert psnr_db(decoder.decode(encoder.encode(frame).data).luma, frame.luma) > 35


def test_grey_frames_are_neutral_in_colour(moving_frames: MakeFrames) -> None:
    frame = moving_frames(1, 20, 12, grey=True)[0]
    encoder = KeyFrameEncoder(20, 12, "lossless")
    got = KeyFrameDecoder(20, 12, encoder.parameter_sets).decode(encoder.encode(frame).data)
    assert same_frame(got, frame.with_chroma())


@pytest.mark.parametrize("predicted", [False, True])
def test_coding_is_repeatable(predicted: bool) -> None:
    encoder, pictures = (ENCODER, CHAIN) if predicted else (INTRA_ENCODER, INTRA)
    other = KeyFrameEncoder(*SIZE, 30, predicted=predicted)
    assert coded(other, FRAMES, (0, 18)) == pictures
    assert other.parameter_sets == encoder.parameter_sets
    assert len(other.parameter_sets) <= 14


def test_predicted_pictures_are_small_and_do_not_drift() -> None:
    """The loop is closed: all pictures of a chain are about as good as intra pictures at their QP."""
    pictures = decoded(KeyFrameDecoder(*SIZE, INTRA_ENCODER.parameter_sets), INTRA)
    predicted = [number for number, picture in enumerate(CHAIN) if picture.predicted]
    for number in predicted:
        assert len(CHAIN[number].data) < 0.5 * len(INTRA[number].data)
        chain_db, intra_db = (psnr_db(FRAMES[number].luma, got[number].luma) for got in (RIGHT, pictures))
        assert chain_db > intra_db - 2.0
    assert predicted == [*range(1, 18), 19]


@pytest.mark.parametrize("luma_only", [False, True])
def test_each_picture_of_a_chain_has_its_qp(luma_only: bool) -> None:
    encoder = KeyFrameEncoder(*SIZE, 30, luma_only=luma_only, predicted=True)
    asked = (30, 20, 45, 10, 51, 2, 51, None, 31, 40, 41)
    pictures = [
        encoder.encode(frame, qp, begins_chain=number in (0, 5, 6))
        for number, (frame, qp) in enumerate(zip(FRAMES, asked, strict=False))
    ]
    assert coded_qps(encoder.parameter_sets, pictures) == [
        {qp} for qp in (27, 20, 45, 10, 51, 1, 48, 30, 31, 40, 41)
    ]


@given(data=st.binary(max_size=300), seed=st.integers(0, 3))
def test_random_bytes_raise_only_bitstream_error(data: bytes, seed: int) -> None:
    encoder = KeyFrameEncoder(32, 32, 30, luma_only=seed % 2 == 0)
    decoder = KeyFrameDecoder(32, 32, encoder.parameter_sets)
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
    encoder = KeyFrameEncoder(320, 240, 40)
    data = encoder.encode(moving_frames(1, 320, 240)[0]).data
    for size in ((32, 32), (336, 240), (304, 240)):
        with pytest.raises(BitstreamError, match="key frame"):
            KeyFrameDecoder(*size, encoder.parameter_sets).decode(data)


@pytest.mark.parametrize("qp", [0, 52, -1, "best", 25.0])
def test_unknown_qp_is_refused(qp: object) -> None:
    with pytest.raises(ValueError, match="`qp` must be 1 to 51 or 'lossless'"):
        KeyFrameEncoder(16, 16, qp)  # type: ignore[arg-type]


def test_wrong_sizes_are_refused(moving_frames: MakeFrames) -> None:
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


@pytest.mark.parametrize(
    "order",
    [(1,), (0, 2), (0, 1, 1), (0, 1, 3), (0, 18, 2), (18, 19, 19)],
    ids=lambda order: "-".join(map(str, order)),
)
def test_references_must_be_there(order: tuple[int, ...]) -> None:
    """A chain without its IDR picture, with one left out, or one twice, is refused up to the next."""
    decoder = fresh_decoder()
    assert same_frames(decoded(decoder, [CHAIN[k] for k in order[:-1]]), [RIGHT[k] for k in order[:-1]])
    for number in (order[-1], 17):
        with pytest.raises(BitstreamError, match=MISSING):
            decoded(decoder, [CHAIN[number]])
    assert same_frames(decoded(decoder, CHAIN[18:]), RIGHT[18:])


def test_idr_pictures_and_predicted_ones_are_not_exchangeable() -> None:
    for number in (0, 1):
        decoder = fresh_decoder()
        decoded(decoder, CHAIN[:number])
        with pytest.raises(BitstreamError, match="key frame"):
            decoder.decode(CHAIN[number].data, predicted=not CHAIN[number].predicted)


@pytest.mark.parametrize(
    ("number", "changes", "message"),
    [
        (2, {"slice_type": 1}, "a slice of type 1, which key pictures do not have"),
        (2, {"slice_type": 6}, "a slice of type 6"),
        (2, {"slice_type": 3}, "a slice of type 3"),
        (2, {"slice_type": 9}, "a slice of type 9"),
        (2, {"slice_type": 2**31}, "a slice of type 2147483648"),
        (0, {"slice_type": 5}, "a slice of type 5"),
        (0, {"slice_type": 1}, "a slice of type 1"),
        (0, {"first_macroblock": 1}, "a slice of type 7"),
        (2, {"first_macroblock": 11}, "a slice of type 5"),
        (2, {"pps": 1}, "a slice of type 5"),
        (0, {"pps": 255}, "a slice of type 7"),
        (0, {"frame_num": 1}, "is missing"),
        (2, {"frame_num": 1}, "is missing"),
        (2, {"frame_num": 3}, "is missing"),
        (2, {"frame_num": 0}, "is missing"),
    ],
)
def test_slices_that_are_not_the_next_picture_are_refused(
    number: int, changes: dict[str, int], message: str
) -> None:
    """Other types, parts of pictures, other parameter sets and wrong order are refused before FFmpeg."""
    decoder = fresh_decoder()
    decoded(decoder, CHAIN[:number])
    head, rest = slice_head(CHAIN[number].data)
    assert head == SliceHead(0, 5 if number else 7, 0, number)
    assert with_head(head, rest) == CHAIN[number].data
    with pytest.raises(BitstreamError, match=f"^key frame: .*{message}"):
        decoder.decode(with_head(replace(head, **changes), rest), predicted=number > 0)
    with pytest.raises(BitstreamError, match=MISSING):
        decoded(decoder, [CHAIN[number + 1]])
    assert same_frames(decoded(decoder, CHAIN[18:]), RIGHT[18:])


@pytest.mark.parametrize("luma_only", [False, True])
def test_damage_ends_a_chain_and_no_more(luma_only: bool) -> None:
    """Flipped bits and cuts are refused, with the rest of the chain, or give a whole picture."""
    encoder = KeyFrameEncoder(*SIZE, 30, luma_only=luma_only, predicted=True)
    chain = coded(encoder, FRAMES[:6], (0, 5))
    decoder = KeyFrameDecoder(*SIZE, encoder.parameter_sets, luma_only=luma_only)
    right = decoded(decoder, chain)
    rng, num_refused = np.random.default_rng(0), 0
    for trial in range(300):
        number = int(rng.integers(0, 4))
        decoded(decoder, chain[:number])
        data, predicted = bytearray(chain[number].data), chain[number].predicted
        if trial % 3:
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        else:
            del data[rng.integers(len(data)) :]
        try:
            got = decoder.decode(bytes(data), predicted=predicted)
        except BitstreamError:
            num_refused += 1
            with pytest.raises(BitstreamError, match=MISSING):
                decoded(decoder, chain[number + 1 : number + 2])
        else:
            assert got.luma.shape == (HEIGHT, WIDTH)
        if trial % 10 == 0:
            assert same_frames(decoded(decoder, chain[5:]), right[5:])
    assert num_refused > 200


def test_parameter_sets_are_those_of_the_twin() -> None:
    sps, pps = split_sets(ENCODER.parameter_sets)
    decoder = KeyFrameDecoder(*SIZE, join_sets(Sps().payload(), pps))
    assert len(sps) == len(Sps().payload())
    assert same_frames(decoded(decoder, CHAIN), RIGHT)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_references": 5}, "5 references, at most 4 are used"),
        ({"num_references": 16}, "16 references"),
        ({"profile": 66}, "profile 66"),
        ({"profile": 110}, "profile 110"),
        ({"macroblocks": (5, 3)}, "pictures of 80x48 pixels, not 64x48"),
        ({"macroblocks": (4, 2**16)}, "pictures of 64x1048576 pixels"),
        ({"gaps": 1}, "not used here"),
        ({"frames_only": 0}, "not used here"),
        ({"scaled": 1}, "not used here"),
        ({"cropped": 1}, "not used here"),
        ({"more_bits": (2, 0)}, "not used here"),
        ({"more_bits": (0, 6)}, "not used here"),
        ({"chroma_format": 2}, "not used here"),
        ({"chroma_format": 3}, "not used here"),
        ({"order_type": 0}, "not used here"),
        ({"order_type": 1}, "not used here"),
        ({"frame_num_bits": 17}, "not used here"),
    ],
)
def test_pictures_of_another_kind_are_refused(changes: dict[str, object], message: str) -> None:
    _, pps = split_sets(ENCODER.parameter_sets)
    sps = replace(Sps(), **changes).payload()  # type: ignore[arg-type]
    with pytest.raises(BitstreamError, match=f"^key frames: the parameter sets are damaged: .*{message}"):
        KeyFrameDecoder(*SIZE, join_sets(sps, pps))


@pytest.mark.parametrize("num_references", [0, 1, 4])
def test_references_that_are_missing_never_crash(num_references: int) -> None:
    _, pps = split_sets(ENCODER.parameter_sets)
    decoder = KeyFrameDecoder(*SIZE, join_sets(Sps(num_references=num_references).payload(), pps))
    for number in (0, 18):
        assert same_frame(decoded(decoder, CHAIN[number : number + 1])[0], RIGHT[number])
        with suppress(BitstreamError):
            assert {frame.luma.shape for frame in decoded(decoder, CHAIN[1:8])} == {(HEIGHT, WIDTH)}
