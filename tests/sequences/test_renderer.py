"""The renderer: determinism, sizes, noise, colour, and a scene's seed."""

import numpy as np
import pytest

from dvc.errors import ConfigError, VideoError
from sequences.renderer import render_frame, to_frame, tone, vignette, ycbcr
from sequences.scenes import descriptions, scene
from tests.clips import same_frame

DETAIL = 0.05
LOOKS = {
    "street": [[98.0, 144.6, 162.3, 140.5], [93.2, 93.4, 150.4, 133.6], [62.6, 116.3, 115.0, 111.2]],
    "stairway": [[114.6, 143.8, 141.5, 147.3], [108.0, 101.0, 144.6, 165.1], [105.9, 116.6, 168.6, 170.6]],
    "rounds": [[114.2, 149.1, 140.9, 149.5], [78.1, 125.3, 145.4, 174.0], [106.8, 158.1, 168.9, 175.1]],
    "statue": [[114.4, 131.9, 157.0, 156.0], [89.8, 112.7, 129.1, 140.4], [157.5, 167.2, 150.8, 156.2]],
}
"""Mean luma of 24 rows by 22 columns of frame 5 at 88x72: figures of streams rest on these pictures."""


def test_same_arguments_give_the_same_bytes() -> None:
    """A scene built twice renders the same samples and depth."""
    first = render_frame(scene("stairway", 0, DETAIL), 7, 64, 48, noise_sigma=1.5)
    second = render_frame(scene.__wrapped__("stairway", 0, DETAIL), 7, 64, 48, noise_sigma=1.5)
    assert same_frame(first.frame, second.frame)
    assert first.depth.tobytes() == second.depth.tobytes()
    assert first.camera.cam_from_world.tobytes() == second.camera.cam_from_world.tobytes()


@pytest.mark.parametrize("name", LOOKS)
def test_scenes_look_as_ever(name: str) -> None:
    """No change of the code may change what is rendered, but for rounding."""
    luma = render_frame(scene(name, 0, DETAIL), 5, 88, 72).frame.luma
    np.testing.assert_allclose(luma.reshape(3, 24, 4, 22).mean(axis=(1, 3)), LOOKS[name], atol=0.2)


def test_another_seed_gives_another_picture() -> None:
    """The seed draws textures and tremor anew."""
    other = scene.__wrapped__("stairway", 1, DETAIL)
    a, b = (render_frame(built, 7, 64, 48).frame for built in (scene("stairway", 0, DETAIL), other))
    assert np.abs(a.luma.astype(int) - b.luma).mean() > 2


@pytest.mark.parametrize(("width", "height"), [(1, 1), (2, 1), (7, 5), (33, 31), (176, 144)])
@pytest.mark.parametrize("samples", [1, 3])
def test_any_size_works(width: int, height: int, samples: int) -> None:
    """Odd and tiny sizes give planes of the right shapes."""
    rendered = render_frame(scene("stairway", 0, DETAIL), 0, width, height, samples=samples)
    assert rendered.frame.luma.shape == rendered.depth.shape == (height, width)
    assert rendered.frame.chroma is not None
    assert rendered.frame.chroma[0].shape == ((height + 1) // 2, (width + 1) // 2)


def test_size_changes_scale_and_not_the_view() -> None:
    """A picture of twice the size, averaged down, is nearly the small picture."""
    stairway = scene("stairway", 0, DETAIL)
    small = render_frame(stairway, 0, 88, 72).frame.luma.astype(float)
    large = render_frame(stairway, 0, 176, 144).frame.luma.astype(float)
    mean = large.reshape(72, 2, 88, 2).mean(axis=(1, 3))
    assert np.corrcoef(mean.ravel(), small.ravel())[0, 1] > 0.97


@pytest.mark.parametrize("name", list(descriptions()))
def test_pictures_are_well_exposed(name: str) -> None:
    """Mid-grey on average, with contrast, neither crushed nor burnt out, within the limited range."""
    luma = render_frame(scene(name, 0, DETAIL), 20, 88, 72).frame.luma
    assert 90 < luma.mean() < 150
    assert luma.std() > 25
    assert luma.min() >= 16
    assert luma.max() <= 235
    assert np.mean(luma > 225) < 0.05


def test_noise_has_the_deviation_that_was_asked_for() -> None:
    """The difference from the clean picture is white, of the right strength, and differs between frames."""
    stairway = scene("stairway", 0, DETAIL)
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
    """White, black and the primaries have their textbook codes."""
    colours = np.array([[1, 1, 1], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    codes = []
    for colour in colours:
        frame = to_frame(ycbcr(np.broadcast_to(colour, (2, 2, 3))), 0.0, None)
        assert frame.chroma is not None
        codes.append((frame.luma[0, 0], frame.chroma[0][0, 0], frame.chroma[1][0, 0]))
    expected = [(235, 128, 128), (16, 128, 128), (81, 90, 240), (145, 54, 34), (41, 240, 110)]
    assert np.abs(np.array(codes, dtype=int) - expected).max() <= 1


def test_tone_curve_rises_from_black_to_white() -> None:
    """More light is never darker; no light is black; the curve ends at 1."""
    values = tone(np.linspace(0, 50, 2000, dtype=np.float32))
    assert values[0] == 0.0
    assert (np.diff(values) >= 0).all()
    assert 0.97 < values[-1] <= 1.0


def test_vignette_is_slight_and_symmetric() -> None:
    """The corners lose a tenth of the light, the middle nothing."""
    fall = vignette(41, 31)[..., 0]
    assert fall[15, 20] == 1.0
    assert fall[0, 0] == pytest.approx(0.9)
    np.testing.assert_allclose(fall, fall[::-1, ::-1])


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
    """A wrong argument raises ValueError that says which."""
    with pytest.raises(ValueError, match=message):
        render_frame(scene("stairway", 0, DETAIL), **{"index": 0, "width": 8, "height": 8, **arguments})


def test_impossible_sizes_are_refused() -> None:
    """A size that no frame may have is refused before anything is allocated."""
    with pytest.raises(VideoError, match="0x8"):
        render_frame(scene("stairway", 0, DETAIL), 0, 0, 8)


def test_unknown_scenes_are_refused() -> None:
    """The message lists the scenes there are."""
    with pytest.raises(ConfigError, match="street, stairway, statue"):
        scene("beach")
    with pytest.raises(ValueError, match="`detail`"):
        scene("street", 0, 0.0)
    with pytest.raises(ValueError, match="`seed`"):
        scene("street", -1)
