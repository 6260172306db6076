"""Planes recorded from decoding, and codes judged on them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recorded_planes import judge, measure_priors, record
from decoder.report import PLANE_CLASSES
from dvc.config import TURBO_FAMILIES, CodecConfig, DiscoverMatrix, VideoConfig, codec_config
from encoder.session import EncoderSession
from tests.clips import moving_texture

CONFIG = codec_config(
    VideoConfig(48, 32, 25, 1, luma_only=True), "2d", DiscoverMatrix(4), turbo={"family": "adaptive"}
)


def encode(config: CodecConfig, path: Path) -> Path:
    """Write the buffered stream of a small clip."""
    frames = [frame.without_chroma() for frame in moving_texture(5, 32, 48)]
    with path.open("wb") as file:
        EncoderSession(config).write(frames, file, lambda _: None)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the planes of two frames of a small clip."""
    folder = tmp_path_factory.mktemp("planes")
    stream = encode(CONFIG, folder / "clip.dvc")
    assert record(stream, folder / "planes.npz") == 2 * sum(CONFIG.wyner_ziv.max_planes)
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


def test_priors_are_compared_with_the_noise_model(tmp_path: Path) -> None:
    """Ideal lengths by the noise model alone are those of its planes; learned ones are of a code."""
    learned = replace(CONFIG, wyner_ziv=replace(CONFIG.wyner_ziv, priors="learned"))
    lengths = measure_priors(encode(learned, tmp_path / "learned.dvc"))
    record(encode(CONFIG, tmp_path / "plain.dvc"), tmp_path / "plain.npz")
    ideal = judge([tmp_path / "plain.npz"], "adaptive").ideal_bits
    for name, (before, after) in lengths.items():
        assert before == pytest.approx(ideal[name], rel=1e-4)
        assert 0.5 < after / before < 1.5
    with pytest.raises(ValueError, match="learned priors"):
        measure_priors(tmp_path / "plain.dvc")
