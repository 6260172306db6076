"""Chains of key pictures: each is predicted from those before it, up to the next IDR picture."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from dvc.errors import BitstreamError
from dvc.keyframes import KeyFrameDecoder, KeyFrameEncoder, KeyPicture, Qp
from dvc.metrics import psnr_db
from dvc.video import Frame
from tests.clips import moving_texture, same_frame
from tests.key_pictures import SliceHead, Sps, coded_qps, join_sets, slice_head, split_sets, with_head

SIZE = WIDTH, HEIGHT = 64, 48
NUM_FRAMES = 20  # more than frame numbers of four bits count
MISSING = "key frame: its reference picture is missing"
FRAMES = moving_texture(NUM_FRAMES, HEIGHT, WIDTH, (0.5, 1.0))


def coded(
    encoder: KeyFrameEncoder, frames: Sequence[Frame], begins: Sequence[int] = (0,)
) -> list[KeyPicture]:
    """Code pictures, of which some begin a chain."""
    return [encoder.encode(frame, begins_chain=number in begins) for number, frame in enumerate(frames)]


def decoded(decoder: KeyFrameDecoder, pictures: Sequence[KeyPicture]) -> list[Frame]:
    return [decoder.decode(picture.data, predicted=picture.predicted) for picture in pictures]


ENCODER = KeyFrameEncoder(*SIZE, 30, predicted=True)
CHAIN = coded(ENCODER, FRAMES, (0, 18))  # a long chain and a short one


def fresh_decoder() -> KeyFrameDecoder:
    return KeyFrameDecoder(*SIZE, ENCODER.parameter_sets)


RIGHT = decoded(fresh_decoder(), CHAIN)


@pytest.mark.parametrize("size", [(48, 32), (33, 25), (1, 1), (2, 3), (17, 1), (16, 40)])
@pytest.mark.parametrize(
    ("luma_only", "qp"), [(False, 22), (True, 30), (False, "lossless"), (True, "lossless")]
)
def test_chains_of_any_size_come_back(
    moving_frames: Callable[..., list[Frame]], size: tuple[int, int], luma_only: bool, qp: Qp
) -> None:
    """In colour or luma, without loss if it is to be; each chain decodes without those before it."""
    frames = moving_frames(6, *size)
    encoder = KeyFrameEncoder(*size, qp, luma_only=luma_only, predicted=True)
    pictures = coded(encoder, frames, (0, 4))
    assert [picture.predicted for picture in pictures] == [False, True, True, True, False, True]
    whole, last = (
        decoded(KeyFrameDecoder(*size, encoder.parameter_sets, luma_only=luma_only), part)
        for part in (pictures, pictures[4:])
    )
    assert all(map(same_frame, whole[4:], last))
    for original, got in zip(frames, whole, strict=True):
        assert (got.width, got.height, got.chroma is None) == (*size, luma_only)
        if qp == "lossless":
            assert same_frame(got, original.without_chroma() if luma_only else original)
        else:
            assert psnr_db(original.luma, got.luma) > 29


def test_predicted_pictures_are_small_and_do_not_drift() -> None:
    """The loop is closed: all pictures of a chain are about as good as intra pictures at their QP."""
    intra = KeyFrameEncoder(*SIZE, 30)
    alone = coded(intra, FRAMES)
    assert not any(picture.predicted for picture in alone)
    pictures = decoded(KeyFrameDecoder(*SIZE, intra.parameter_sets), alone)
    predicted = [number for number, picture in enumerate(CHAIN) if picture.predicted]
    for number in predicted:
        assert len(CHAIN[number].data) < 0.5 * len(alone[number].data)
        own_db, intra_db = (psnr_db(FRAMES[number].luma, found[number].luma) for found in (RIGHT, pictures))
        assert own_db > intra_db - 2.0
    assert predicted == [*range(1, 18), 19]


def test_coding_is_repeatable() -> None:
    """Two encoders write the same bytes, and parameter sets of a dozen."""
    other = KeyFrameEncoder(*SIZE, 30, predicted=True)
    assert coded(other, FRAMES, (0, 18)) == CHAIN
    assert other.parameter_sets == ENCODER.parameter_sets
    assert len(other.parameter_sets) <= 14


@pytest.mark.parametrize("luma_only", [False, True])
def test_each_picture_has_the_qp_that_is_asked_for(luma_only: bool) -> None:
    """All its macroblocks; IDR pictures, on which a chain rests, are three finer."""
    encoder = KeyFrameEncoder(*SIZE, 30, luma_only=luma_only, predicted=True)
    asked = (30, 20, 45, 10, 51, 2, 51, None, 31, 40, 41)
    pictures = [
        encoder.encode(frame, qp, begins_chain=number in (0, 5, 6))
        for number, (frame, qp) in enumerate(zip(FRAMES, asked, strict=False))
    ]
    assert coded_qps(encoder.parameter_sets, pictures) == [
        {qp} for qp in (27, 20, 45, 10, 51, 1, 48, 30, 31, 40, 41)
    ]


@pytest.mark.parametrize(
    "order",
    [(1,), (0, 2), (0, 1, 1), (0, 1, 3), (0, 18, 2), (18, 19, 19)],
    ids=lambda order: "-".join(map(str, order)),
)
def test_what_a_picture_is_predicted_from_must_be_there(order: tuple[int, ...]) -> None:
    """A chain without its IDR picture, with one left out, or one twice, is refused up to the next."""
    decoder = fresh_decoder()
    assert all(map(same_frame, decoded(decoder, [CHAIN[k] for k in order[:-1]]), (RIGHT[k] for k in order)))
    for number in (order[-1], 17):
        with pytest.raises(BitstreamError, match=MISSING):
            decoded(decoder, [CHAIN[number]])
    assert all(map(same_frame, decoded(decoder, CHAIN[18:]), RIGHT[18:]))


def test_an_idr_picture_may_not_pass_for_a_predicted_one() -> None:
    """Nor the other way round."""
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
    """Before FFmpeg's decoder sees them: of other types, parts of pictures, of other sets, out of order."""
    decoder = fresh_decoder()
    decoded(decoder, CHAIN[:number])
    head, rest = slice_head(CHAIN[number].data)
    assert head == SliceHead(0, 5 if number else 7, 0, number)
    assert with_head(head, rest) == CHAIN[number].data
    with pytest.raises(BitstreamError, match=f"^key frame: .*{message}"):
        decoder.decode(with_head(replace(head, **changes), rest), predicted=number > 0)
    with pytest.raises(BitstreamError, match=MISSING):
        decoded(decoder, [CHAIN[number + 1]])
    assert all(map(same_frame, decoded(decoder, CHAIN[18:]), RIGHT[18:]))


def test_damage_costs_a_chain_and_no_more() -> None:
    """What is cut or flipped is refused, and all after it up to an IDR picture, or makes a picture."""
    rng = np.random.default_rng(0)
    found = 0
    for trial in range(150):
        decoder, place = fresh_decoder(), int(rng.integers(0, 4))
        decoded(decoder, CHAIN[:place])
        picture = CHAIN[place]
        data = bytearray(picture.data)
        if trial % 3:
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        else:
            del data[rng.integers(len(data)) :]
        try:
            got = decoder.decode(bytes(data), predicted=picture.predicted)
        except BitstreamError:
            found += 1
            with pytest.raises(BitstreamError, match=MISSING):
                decoded(decoder, CHAIN[place + 1 : place + 2])
        else:
            assert got.luma.shape == (HEIGHT, WIDTH)
        assert all(map(same_frame, decoded(decoder, CHAIN[18:]), RIGHT[18:]))
    assert found > 100


def test_parameter_sets_are_those_of_the_twin() -> None:
    """Written field by field, they decode the chain."""
    sps, pps = split_sets(ENCODER.parameter_sets)
    decoder = KeyFrameDecoder(*SIZE, join_sets(Sps().payload(), pps))
    assert len(sps) == len(Sps().payload())
    assert all(map(same_frame, decoded(decoder, CHAIN), RIGHT))


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
    """Before any is decoded: a decoder makes no room for what key frames do not need."""
    _, pps = split_sets(ENCODER.parameter_sets)
    sps = replace(Sps(), **changes).payload()  # type: ignore[arg-type]
    with pytest.raises(BitstreamError, match=f"^key frames: the parameter sets are damaged: .*{message}"):
        KeyFrameDecoder(*SIZE, join_sets(sps, pps))


@pytest.mark.parametrize("num_references", [0, 1, 4])
def test_references_that_are_missing_never_crash(num_references: int) -> None:
    """Parameter sets may say that fewer pictures are kept than are used."""
    _, pps = split_sets(ENCODER.parameter_sets)
    decoder = KeyFrameDecoder(*SIZE, join_sets(Sps(num_references=num_references).payload(), pps))
    for number in (0, 18):
        assert same_frame(decoded(decoder, CHAIN[number : number + 1])[0], RIGHT[number])
        with suppress(BitstreamError):
            assert {frame.luma.shape for frame in decoded(decoder, CHAIN[1:8])} == {(HEIGHT, WIDTH)}
