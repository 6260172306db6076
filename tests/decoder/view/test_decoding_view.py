"""What a page shows of a run: latest figures, pictures of a bounded number of frames, each as it is."""

from fractions import Fraction

import cv2
import numpy as np
import pytest

from decoder.report import DecodedPicture
from decoder.view import decoding_view
from decoder.view.decoding_view import KINDS, DecodingView
from dvc.config import Qp, VideoConfig, codec_config
from dvc.video import Frame

FACTS = codec_config(VideoConfig(64, 48, 30, 1), "2d", Qp(34)), "a.dvc", 9
CAMERA = np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 3]])


def picture(index: int, key: bool = False, camera: np.ndarray | None = CAMERA) -> DecodedPicture:
    luma = np.full((16, 32), 100, np.uint8)
    chroma = (np.full((8, 16), 90, np.uint8), np.full((8, 16), 200, np.uint8))
    report = {
        "index": index,
        "type": "key" if key else "wz",
        "bits": {"key": 3, "parity": index},
        "psnr_y_db": None,
    }
    if key:
        return DecodedPicture(Fraction(index, 25), Frame(luma, chroma), None, None, None, report)
    depth = np.tile(np.linspace(0, 1, 32), (16, 1)).astype(np.float16)
    return DecodedPicture(Fraction(index, 25), Frame(luma, chroma), luma - 10, depth, camera, report)


def drawn(view: DecodingView, index: int, kind: str) -> np.ndarray:
    jpeg = view.jpeg(index, kind)
    assert jpeg is not None
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).astype(int)


def test_figures_of_later_frames() -> None:
    view = DecodingView(*FACTS, lambda: 7)
    assert view.state(-1)["first_picture"] is None
    view.add(picture(0, key=True), 0)
    view.add(picture(1), 1)
    view.add(picture(2, camera=np.zeros((3, 4))), 1)
    state = view.state(0)
    assert (state["name"], state["total"], state["num_frames"], state["finished"]) == ("a.dvc", 9, 3, False)
    assert state["facts"].startswith("64x48 at 30 Hz, codec 2d, ")
    assert state["facts"].endswith("colour, key frames of QP 34")
    assert (state["bits"], state["requests_in_flight"]) == ({"key": 9, "parity": 3}, 7)
    assert [row["index"] for row in state["rows"]] == [1, 2]
    assert [row["centre"] for row in state["rows"]] == [[2.0, 0.0, -3.0], None]
    assert [row["group"] for row in view.state(-1)["rows"]] == [0, 1, 1]
    view.finish()
    assert view.state(2)["finished"]


def test_pictures() -> None:
    view = DecodingView(*FACTS)
    view.add(picture(0, key=True), 0)
    view.add(picture(1), 0)
    # Black is 16, white 235, as in nearly every video.
    np.testing.assert_allclose(drawn(view, 1, "decoded")[8, 16], [21, 54, 213], atol=6)
    np.testing.assert_allclose(drawn(view, 1, "predicted"), 90, atol=2)
    np.testing.assert_allclose(drawn(view, 1, "difference"), 128 + 4 * 10, atol=2)
    depth = drawn(view, 1, "depth").sum(axis=2)
    assert depth[8, -1] > depth[8, 0] + 100
    assert [view.jpeg(0, kind) is not None for kind in KINDS] == [True, False, False, False]
    assert view.jpeg(2, "decoded") is None


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding_view, "MAX_PICTURE_PX", 3 * 16 * 32)
    monkeypatch.setattr(decoding_view, "NUM_ROWS", 5)
    view = DecodingView(*FACTS)
    for index in range(9):
        view.add(picture(index), 0)
    assert [index for index in range(9) if view.jpeg(index, "decoded")] == [6, 7, 8]
    assert (view.state(-1)["first_picture"], len(view.state(-1)["rows"]), view.state(-1)["num_frames"]) == (
        6,
        5,
        9,
    )
    monkeypatch.setattr(decoding_view, "MAX_PICTURE_PX", 1)
    view.add(picture(9), 0)
    assert [index for index in range(10) if view.jpeg(index, "decoded")] == [9]
