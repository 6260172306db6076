"""Chapter 3: own small views by both ways, its codecs and its rendering as they are written."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.baselines.thesis_disparities import LaplacianCodec
from benchmarks.thesis.__main__ import main
from benchmarks.thesis.chapter3 import CHAPTER, NUM_LEVELS, load_scene
from benchmarks.thesis.harness import Method, Task
from benchmarks.thesis.scenes import Scene, everywhere_valid
from benchmarks.thesis.view_curves import (
    CODERS,
    PLAIN_QUADTREE,
    Coder,
    curve,
    layered_points,
    reference_multipliers,
    render_planes,
)
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM
from dvc.dibr.disparity.tree_codec import WaveletCodec
from dvc.dibr.view_encoder import ViewEncoder
from dvc.dibr.view_rendering import PictureAndDisparity
from dvc.dibr.view_stream import decode, decode_stream
from dvc.geometry.camera_array import ArrayView, CameraArray, LatticePosition
from dvc.picture_files import write_png
from tests.dibr.scenes import FAR, LABELS, NEAR, planes
from tests.stereo.data import REAL_SETS, real_set

SCENE = Scene(planes(64, 80), LABELS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that the command writes for two small views."""
    scratch = tmp_path_factory.mktemp("views")
    for view in planes(64, 80):
        write_png(scratch / f"{view.name}.png", np.ascontiguousarray(view.image[:, :, ::-1]))
    views = [str(scratch / "left.png"), str(scratch / "right.png"), "--disparities", "0:9"]
    assert main(["--chapter", "3", *views, "--out", str(scratch / "out"), "--quiet"]) == 0
    return scratch / "out" / "chapter3"


def test_all_figures_are_drawn(folder: Path) -> None:
    """Every figure except diagrams is drawn by both methods; the document has the numbers of both."""
    names = {path.name for path in folder.glob("*.png")}
    both = {
        f"figure-{n}-views-{method}.png"
        for n in ("3.9", "3.9b", "3.10", "3.12", "3.13", "3.14", "3.15")
        for method in Method
    }
    assert names == both | {"figure-3.4-views-thesis.png"}
    values = json.loads((folder / "chapter3.json").read_text())
    gains = {(value["label"], value["method"]) for value in values if value["source"] == "Figure 3.13"}
    assert {("views: L over quadtrees [dB]", method) for method in ("thesis", "ours")} <= gains
    assert (f"views: L over {PLAIN_QUADTREE.replace('quadtree', 'quadtrees', 1)} [dB]", "ours") in gains
    assert len([value for value in values if "largest loss" in value["label"]]) == 4


@pytest.mark.parametrize("method", Method)
def test_rates_are_those_of_streams_that_decode(method: Method) -> None:
    """Smaller lambdas cost more and look better; streams decode to the disparities of the encoder."""
    for coder in CODERS[method].values():
        points = curve(SCENE.views, LABELS, coder, (1e-2, 4e-4), method)
        sizes = [point.num_bytes for point in points]
        assert sizes == sorted(sizes)
        assert points[1].quality.pooled_db > points[0].quality.pooled_db + 1.0
        encoded = ViewEncoder(SCENE.views, LABELS, coder.kind, codec=coder.codec).encode(1e-2)
        assert len(encoded.data) == points[0].num_bytes
        pair = decode(decode_stream(encoded.data), codec=coder.codec).pairs[0]
        np.testing.assert_array_equal(pair.disparity, points[0].pair.disparity)


def test_quality_layers_as_written_refine_each_other() -> None:
    """Each layer has more bytes, and the last one is as good as a file without layers nearly is."""
    coder = CODERS[Method.THESIS]["l"]
    points = layered_points(SCENE.views, LABELS, coder, 4e-4, 3, Method.THESIS)
    assert [point.num_bytes for point in points] == sorted({point.num_bytes for point in points})
    (single,) = curve(SCENE.views, LABELS, coder, (4e-4,), Method.THESIS)
    assert points[-1].quality.pooled_db > single.quality.pooled_db - 1.0


@pytest.mark.parametrize("make", [LaplacianCodec, WaveletCodec])
def test_stopping_early_stores_more_roots(make: type[LaplacianCodec] | type[WaveletCodec]) -> None:
    """A tree that ends earlier has more roots, and its stream decodes, too."""
    sizes = []
    for num_levels in (None, 2):
        coder = Coder("l", make(L_TRANSFORM, num_levels))
        (point,) = curve(SCENE.views, LABELS, coder, (2e-3,))
        sizes.append(point.disparity_bytes)
    assert sizes[1] > sizes[0]
    assert None in NUM_LEVELS.values()


def test_planes_are_rendered_far_to_near() -> None:
    """A square covers the background, moves with its disparity, and its hole takes the surrounding levels."""
    picture = np.full((20, 40), 50, np.uint8)
    disparity = np.full((20, 40), float(FAR))
    picture[5:15, 20:30], disparity[5:15, 20:30] = 200, NEAR
    pair = PictureAndDisparity(picture, disparity, LatticePosition(0.0, 0.0))
    same = render_planes(pair, LatticePosition(0.0, 0.0))
    np.testing.assert_array_equal(same, picture)
    found = render_planes(pair, LatticePosition(1.0, 0.0))
    assert (found[5:15, 20 - NEAR : 30 - NEAR] == 200).all()
    hole = found[5:15, 30 - NEAR : 30 - FAR]
    assert ((hole >= 50) & (hole <= 200)).all()
    assert hole.mean() > 55, "the Poisson equation knows no background"


def test_half_pixels_are_bilinear() -> None:
    """Between two levels lies their mean."""
    picture = np.tile(np.array([10, 30], np.uint8), (6, 5))
    pair = PictureAndDisparity(picture, np.ones((6, 10)), LatticePosition(0.0, 0.0))
    assert (render_planes(pair, LatticePosition(0.5, 0.0))[:, 1:-1] == 20).all()


def test_codecs_as_written_know_nothing_of_rendering() -> None:
    """Errors of rendered views change neither trees nor quadtrees."""
    for name, coder in CODERS[Method.THESIS].items():
        rng = np.random.default_rng(3)
        tensor = rng.random((16, 16, 8)).astype(np.float32)
        plain = coder.codec.optimise(tensor, 1e-2)
        asked = coder.codec.optimise(tensor, 1e-2, distortion=_Refused())
        np.testing.assert_array_equal(plain.disparity(), asked.disparity(), name)


class _Refused:
    """A distortion that must not be asked."""

    parallax = 1.0

    def __getattr__(self, name: str) -> None:
        raise AssertionError(name)


def test_scenes_are_those_of_the_thesis(tmp_path: Path) -> None:
    """Teddy and Tsukuba in the quick preset, more in the full one; without data those that need none."""
    task = Task(tmp_path, REAL_SETS)
    names = {step.name.split("-")[1] for step in CHAPTER.steps(task)}
    assert names == {"teddy", "tsukuba"}
    more = {step.name for step in CHAPTER.steps(replace(task, full=True))}
    assert {"methods-cones", "methods-cgtoy", "baselines-teddy"} <= more
    assert {step.name.split("-")[1] for step in CHAPTER.steps(Task(tmp_path))} == {"toy", "motorcycle"}


def test_multipliers_give_the_rates_of_the_reference() -> None:
    """The picture takes about the rate of its multiplier."""
    views = Scene(planes(96, 128), LABELS).views
    (multiplier,) = reference_multipliers(views, [0.5])
    encoded = ViewEncoder(views, LABELS).encode(multiplier)
    assert 0.35 <= 8 * encoded.picture_bytes / (96 * 128) <= 0.7


def test_views_are_cropped_to_what_all_see() -> None:
    """The common frame has no pixel that a camera has not seen, and is not smaller than it must be."""
    image = np.arange(20 * 30 * 3, dtype=np.uint64).astype(np.uint8).reshape(20, 30, 3)
    valid = np.ones((20, 30), np.bool_)
    valid[:3], valid[:, -2:] = False, False
    views = ArrayView("a", image, LatticePosition(0, 0), valid), ArrayView("b", image, LatticePosition(1, 0))
    found = everywhere_valid(CameraArray(views))
    assert found.shape == (17, 28)
    np.testing.assert_array_equal(found[1].image, image[3:, :-2])


def test_real_sets_are_as_in_the_thesis() -> None:
    """Tsukuba has nine views without its border, the reference first; Teddy two."""
    real_set("tsukuba")
    tsukuba, teddy, cones = (
        load_scene(name, Task(REAL_SETS, REAL_SETS)) for name in ("tsukuba", "teddy", "cones")
    )
    assert tsukuba.array.shape == (284, 380)
    assert len(tsukuba.array) == 9
    assert tsukuba.array[0].name == "scene1.row3.col3"
    assert [view.name for view in tsukuba.pair] == ["scene1.row3.col3", "scene1.row3.col4"]
    assert len(teddy.array) == 2
    assert [view.name for view in cones.pair] == ["im2", "im6"]
