"""Planes recorded from decoding, and codes judged on them."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.recorded_planes import judge, record
from decoder.report import PLANE_CLASSES
from dvc.config import TURBO_FAMILIES, CodecConfig, GopConfig, VideoConfig, WynerZivConfig
from encoder.session import EncoderSession
from tests.clips import moving_texture

CONFIG = CodecConfig.preset(
    "2d", VideoConfig(48, 32, 25, 1, luma_only=True), gop=GopConfig(2), wyner_ziv=WynerZivConfig.preset(4)
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the planes of two frames of a small clip."""
    folder = tmp_path_factory.mktemp("planes")
    frames = [frame.without_chroma() for frame in moving_texture(5, 32, 48)]
    with (folder / "clip.dvc").open("wb") as file:
        EncoderSession(CONFIG).write(frames, file, lambda _: None)
    assert record(folder / "clip.dvc", folder / "planes.npz") == 2 * sum(CONFIG.wyner_ziv.max_planes)
    return folder / "planes.npz"


def test_recordings_hold_bands_and_planes(recording: Path) -> None:
    """Every plane of every frame has its band, side information that mostly tells its bits, and its bits."""
    with np.load(recording) as arrays:
        assert set(arrays["places"][:, 0].tolist()) == {1, 3}
        bands = arrays["bands"].tolist()
        expected = [band for band, count in enumerate(CONFIG.wyner_ziv.max_planes) for _ in range(count)]
        assert bands == 2 * expected
        right = (arrays["llr"] < 0) == (arrays["bits"] == 1)
        assert right.shape[1] == CONFIG.video.num_blocks
        assert right.mean() > 0.7


@pytest.mark.parametrize("family", TURBO_FAMILIES)
def test_codes_are_judged_on_the_same_planes(recording: Path, family: str) -> None:
    """All families decode the planes; their ideal length is that of the recording, whatever the code."""
    found = judge([recording], family)
    assert (found.num_planes, found.num_wrong) == (2 * sum(CONFIG.wyner_ziv.max_planes), 0)
    assert found.num_requests >= found.num_planes
    ideal = judge([recording], "adaptive").ideal_bits
    assert found.ideal_bits == pytest.approx(ideal)
    ratio = found.ratio(*PLANE_CLASSES)
    assert ratio is not None
    assert 1.0 < ratio < 3.0
