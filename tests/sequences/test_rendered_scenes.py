"""The renderer: determinism, sizes, noise, colour, and a scene's seed."""

import numpy as np
import pytest

from dvc.errors import ConfigError, VideoError
from sequences.rendered_scenes import render_frame, resolve, scene, to_frame, tone, ycbcr
from sequences.scene_layouts import VIDEO_SCENES
from tests.clips import same_frame

LOOKS = {
    "street": [[97.1, 155.8, 168.9, 135.0], [86.3, 84.8, 130.2, 132.9], [94.2, 120.3, 133.2, 117.9]],
    "stairway": [[99.9, 104.7, 146.5, 145.9], [105.5, 112.1, 163.3, 170.5], [107.0, 134.9, 180.6, 186.9]],
    "rounds": [[66.9, 123.8, 143.3, 147.3], [85.4, 139.5, 162.9, 175.4], [134.2, 170.5, 186.4, 184.1]],
    "statue": [[132.5, 138.6, 142.6, 140.1], [119.9, 134.8, 137.7, 106.1], [157.0, 163.2, 144.5, 154.3]],
}
"""Mean luma of 24 rows by 22 columns of frame 5 at 88x72: published rates depend on these pictures."""


def test_same_arguments_give_the_same_bytes() -> None:
    first = render_frame(scene("stairway"), 7, 64, 48, noise_sigma=1.5)
    second = render_frame(scene.__wrapped__("stairway"), 7, 64, 48, noise_sigma=1.5)
    assert same_frame(first.frame, second.frame)
    assert first.depth.tobytes() == second.depth.tobytes()
    assert first.camera.cam_from_world.tobytes() == second.camera.cam_from_world.tobytes()
    other = render_frame(scene.__wrapped__("stairway", 1), 7, 64, 48)
    assert np.abs(first.frame.luma.astype(int) - other.frame.luma).mean() > 2


@pytest.mark.parametrize("name", LOOKS)
def test_scenes_do_not_change(name: str) -> None:
    luma = render_frame(scene(name), 5, 88, 72).frame.luma
    np.testing.assert_allclose(luma.reshape(3, 24, 4, 22).mean(axis=(1, 3)), LOOKS[name], atol=0.2)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (2, 1), (7, 5), (33, 31), (176, 144)])
@pytest.mark.parametrize("samples", [1, 3])
def test_any_size_works(width: int, height: int, samples: int) -> None:
    rendered = render_frame(scene("stairway"), 0, width, height, samples=samples)
    assert rendered.frame.luma.shape == rendered.depth.shape == (height, width)
    assert rendered.frame.chroma is not None
    assert rendered.frame.chroma[0].shape == ((height + 1) // 2, (width + 1) // 2)


def test_size_changes_scale_and_not_the_view() -> None:
    stairway = scene("stairway")
    small = render_frame(stairway, 0, 88, 72).frame.luma.astype(float)
    large = render_frame(stairway, 0, 176, 144).frame.luma.astype(float)
    mean = large.reshape(72, 2, 88, 2).mean(axis=(1, 3))
    assert np.corrcoef(mean.ravel(), small.ravel())[0, 1] > 0.97


@pytest.mark.parametrize("name", list(VIDEO_SCENES))
def test_pictures_are_well_exposed(name: str) -> None:
    """Mid-grey on average, with contrast, neither crushed nor burnt out, within the limited range."""
    luma = render_frame(scene(name), 20, 88, 72).frame.luma
    assert 90 < luma.mean() < 150
    assert luma.std() > 25
    assert luma.min() >= 16
    assert luma.max() <= 235
    assert np.mean(luma > 225) < 0.05


def test_noise_has_the_deviation_that_was_asked_for() -> None:
    """The difference from the clean picture is white, of the right strength, and differs between frames."""
    stairway = scene("stairway")
    residuals = []
    for index in (0, 1):
        clean = render_frame(stairway, index, 176, 144, samples=1).frame
        noisy = render_frame(stairway, index, 176, 144, samples=1, noise_sigma=3.0).frame
        residuals.append(noisy.luma.astype(float) - clean.luma)
        assert clean.chroma is not None
        assert noisy.chroma is not None
        assert np.std(noisy.chroma[0].astype(float) - clean.chroma[0]) == pytest.approx(1.55, abs=0.15)
    for residual in residuals:
        assert residual.mean() == pytest.approx(0.0, abs=0.1)
        assert residual.std() == pytest.approx(3.0, abs=0.12)
        assert abs(np.corrcoef(residual[:, 1:].ravel(), residual[:, :-1].ravel())[0, 1]) < 0.03
    assert abs(np.corrcoef(residuals[0].ravel(), residuals[1].ravel())[0, 1]) < 0.03


def test_colours_follow_bt601() -> None:
    colours = np.array([[1, 1, 1], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    codes = []
    for colour in colours:
        frame = to_frame(ycbcr(np.broadcast_to(colour, (2, 2, 3))))
        assert frame.chroma is not None
        codes.append((frame.luma[0, 0], frame.chroma[0][0, 0], frame.chroma[1][0, 0]))
    expected = [(235, 128, 128), (16, 128, 128), (81, 90, 240), (145, 54, 34), (41, 240, 110)]
    assert np.abs(np.array(codes, dtype=int) - expected).max() <= 1


def test_tone_curve_rises_from_black_to_white() -> None:
    values = tone(np.linspace(0, 50, 2000, dtype=np.float32))
    assert values[0] == 0.0
    assert (np.diff(values) >= 0).all()
    assert 0.97 < values[-1] <= 1.0


def test_pixels_are_separable_averages_of_samples() -> None:
    samples = np.random.default_rng(8).random((11, 14, 3)).astype(np.float32)
    taps = (np.array([1, 2, 3, 2, 1]) / 9).astype(np.float32)
    pixels = resolve(samples, taps, 3)
    assert pixels.shape == (3, 4, 3)
    for i, j in np.ndindex(3, 4):
        window = samples[3 * i : 3 * i + 5, 3 * j : 3 * j + 5]
        np.testing.assert_allclose(pixels[i, j], np.einsum("i,j,ijk", taps, taps, window), rtol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"index": -1}, "`index`"),
        ({"samples": 2}, "`samples`"),
        ({"samples": 0}, "`samples`"),
        ({"noise_sigma": -1.0}, "`noise_sigma`"),
    ],
)
def test_arguments_out_of_range_are_named(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        render_frame(scene("stairway"), **{"index": 0, "width": 8, "height": 8, **arguments})


def test_unknown_scenes_and_impossible_sizes_are_refused() -> None:
    with pytest.raises(VideoError, match="0x8"):
        render_frame(scene("stairway"), 0, 0, 8)
    with pytest.raises(ConfigError, match="street, stairway, statue"):
        scene("beach")
    with pytest.raises(ValueError, match="`seed`"):
        scene("street", -1)
