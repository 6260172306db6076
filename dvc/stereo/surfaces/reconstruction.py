"""Surfaces of all cameras of an array: from costs to surfaces to occupancy to visibility and back.

Each iteration infers the labels of every camera from its photometric cost (2.13), keeps what several cameras
agree on (2.15), and continues it over the rest. The next one knows from these surfaces what is hidden from
whom (2.17), and its windows follow them. In the end, where labels are finer than pixels, each camera takes
what most of those that see a point say of it.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels
from dvc.geometry.surfaces import Reconstruction, Surface
from dvc.geometry.volumes.aggregation import Arms, Window, cross_arms
from dvc.geometry.volumes.inference import Inferred
from dvc.geometry.volumes.matching_costs import COSTS, Band, CensusCost
from dvc.stereo.surfaces import _kernels
from dvc.stereo.surfaces.confidence import confidence, evidence
from dvc.stereo.surfaces.continuation import continued
from dvc.stereo.surfaces.exposure import EXPOSURE_RATIO, gains, with_gains
from dvc.stereo.surfaces.fusion import FUSION_ROUNDS, fused
from dvc.stereo.surfaces.occupancy import (
    Occupancy,
    exactly_supported,
    fineness,
    neighbours,
    seen_elsewhere,
    supported,
)
from dvc.stereo.surfaces.photometric import Comparison, Regions, photometric_cost
from dvc.stereo.surfaces.settings import StereoSettings

Labels = NDArray[np.int64]
Floats = NDArray[np.float64]

MAX_CELLS = 24_000_000
"""Pixels times labels that are inferred at once; larger views are cut into strips of rows."""
MOST_CELLS = 128_000_000
"""Strips cannot be narrower than what they share; about 32 bytes each in every thread, 4 GiB in all."""
LARGE_CELLS = 40_000_000
"""Above it, views of half the size tell first which labels are tried."""
HALF_BAND_PX, BAND_ITERATIONS = 5, 2
"""Parallax that is then tried at each pixel to both sides of that of the half; and how often."""
OVERLAP_ROWS = 80
"""Rows by which strips reach into each other: as far as the arms of pixels."""
BASE_MEDIAN_PX = 5
"""Side of the median that frees a base surface of single wrong labels."""
PLANE_RADIUS_PX, PLANE_SPACING_PX = 14, 2
"""Window of the planes that give disparities between those of the labels, and of the pixels that count."""
PLANE_TOLERANCE_PX, MOST_REFINED_PX = 2.25, 0.75
"""Parallax by which the farthest pixel of a plane may differ, and by which a pixel changes."""
PLANE_LEVELS, CONTINUED_WEIGHT, STIFFNESS_PX2 = 40.0, 0.2, 0.5
"""See `_kernels.PlaneWindow`; all of planes was chosen on `settings.TUNING_PAIRS`."""
LEAST_SIDE_PX, EXPOSURE_ROUNDS = 120, 2
"""Shorter side of the views, halved as often, that tell exposures; how often these are compared."""

DEFAULT_SETTINGS = StereoSettings()


@dataclass(frozen=True, eq=False)
class _State:
    """What is known of the scene between two iterations."""

    occupancy: list[Occupancy]
    inferred: list[Inferred]
    filled: list[Floats]
    bases: list[Labels]


def reconstruct(
    array: CameraArray,
    labels: DisparityLabels,
    settings: StereoSettings = DEFAULT_SETTINGS,
    *,
    jobs: int = 1,
    advance: Callable[[int], None] = lambda _: None,
) -> Reconstruction:
    """Find the surfaces of all views.

    Parameters
    ----------
    array : CameraArray
        At least two views.
    labels : DisparityLabels
        Disparities to try.
    settings : StereoSettings, optional
        How.
    jobs : int, optional
        Threads; the result is the same for any number.
    advance : callable, optional
        Told the number of views of an iteration that have just been finished; there are `most_steps` in all,
        or fewer.

    Returns
    -------
    Reconstruction
        A surface for each view.

    Raises
    ------
    ConfigError
        If there are so many labels that views as wide cannot be inferred in a few gigabytes.
    """
    with ThreadPoolExecutor(jobs) as pool:
        solver = _Solver(array, labels, settings, pool, advance)
        solver = solver.equally_exposed() if settings.exposures else solver
        state, changes = solver.solve()
        surfaces = solver.surfaces(state)
    figures = {"iterations": len(changes), "changed": [round(change, 6) for change in changes]}
    return Reconstruction(array, labels, surfaces, figures)


def most_steps(array: CameraArray, labels: DisparityLabels, settings: StereoSettings) -> int:
    """Return how many views of iterations `reconstruct` finishes if none ends early."""
    (height, width), num_labels = array.shape, labels.num_labels
    iterations, band = settings.max_iterations, 2 * _half_band(fineness(array, labels)) + 1
    while _is_large((height, width), num_labels, band):
        height, width, num_labels = height // 2, width // 2, _halved(num_labels)
        iterations += BAND_ITERATIONS
    return iterations * len(array)


class _Solver:
    """The loop over all cameras of one array."""

    def __init__(
        self,
        array: CameraArray,
        labels: DisparityLabels,
        settings: StereoSettings,
        pool: ThreadPoolExecutor,
        advance: Callable[[int], None],
    ) -> None:
        self.array, self.labels, self.settings = array, labels, settings
        self.pool, self.advance = pool, advance
        self.comparison = Comparison(array, labels, COSTS[settings.cost], undefined=settings.undefined_cost)
        self.arms: dict[tuple[int, Window], Arms] = {}
        self.near = [neighbours(array, index) for index in range(len(array))]
        self.half_band = _half_band(self.comparison.fineness)
        band = 2 * self.half_band + 1
        self.is_large = _is_large(array.shape, labels.num_labels, band)
        self.num_labels = band if self.is_large else labels.num_labels
        self.strips = _strips(array.shape, self.num_labels)
        rows = min(self.strips[0].stop + 2 * OVERLAP_ROWS, array.shape[0])
        if rows * array.shape[1] * self.num_labels > MOST_CELLS:
            raise ConfigError(
                f"{labels.num_labels} disparities in steps of {labels.step:g} px are too many for the memory "
                f"that views {array.shape[1]} pixels wide need: larger steps or smaller views are accepted"
            )

    def equally_exposed(self) -> "_Solver":
        """Give all views the exposure of the reference, as surfaces of small views tell it."""
        small, labels, array = self.array, self.labels, self.array
        while min(small.shape) >= 2 * LEAST_SIDE_PX:
            small, labels = CameraArray(tuple(map(_half, small))), _half_range(labels)
        once = replace(self.settings, max_iterations=1)
        for _ in range(EXPOSURE_ROUNDS):
            solver = _Solver(small, labels, once, self.pool, lambda _: None)
            solver.comparison = replace(solver.comparison, cost=CensusCost(has_levels=False))
            found = gains(small, labels, solver.solve()[0].occupancy[small.reference])
            if max(found.max(), 1.0 / found.min()) <= EXPOSURE_RATIO:
                break
            small, array = with_gains(small, found), with_gains(array, found)
        return _Solver(array, self.labels, self.settings, self.pool, self.advance)

    def solve(self) -> tuple[_State, list[float]]:
        """Iterate until nothing changes; return what is known then, and what share each iteration changed."""
        state = self._coarse() if self.is_large else None
        changes: list[float] = []
        for _ in range(BAND_ITERATIONS if self.is_large else self.settings.max_iterations):
            found = self._iterated(state)
            changes.append(1.0 if state is None else _changed(state, found))
            state = found
            if changes[-1] < self.settings.min_change:
                break
        assert state is not None
        return state, changes

    def _coarse(self) -> _State:
        """What views of half the size tell."""
        labels = self.labels
        views = tuple(_half(view) for view in self.array)
        solver = _Solver(CameraArray(views), _half_range(labels), self.settings, self.pool, self.advance)
        state, _ = solver.solve()
        filled = [_doubled(surface, self.array.shape, labels) for surface in state.filled]
        bases = [_base(surface, labels) for surface in filled]
        near = [_repeated(occupancy.supported, self.array.shape) for occupancy in state.occupancy]
        occupancy = [Occupancy(*pair) for pair in zip(bases, near, strict=True)]
        return _State(occupancy, [], filled, bases)

    def _iterated(self, state: _State | None) -> _State:
        """Find all surfaces once, from what is known."""
        views = range(len(self.array))

        def _infer(task: tuple[int, slice]) -> Inferred:
            return self._inferred(state, *task)

        self._grow_arms(self.settings.windows(0 if state is None else 1))
        parts = self.pool.map(_infer, [(index, strip) for index in views for strip in self.strips])
        inferred = []
        for _ in views:
            inferred.append(_joined([next(parts) for _ in self.strips], self.strips))
            self.advance(1)
        maps = [found.label for found in inferred]

        test = exactly_supported if self.settings.agreement == "exact" else supported

        def _supported(index: int) -> Occupancy:
            return Occupancy(maps[index], test(self.array, self.labels, maps, index))

        occupancy = list(self.pool.map(_supported, views))
        if self.settings.filling == "inferred":
            nothing = np.zeros(self.array.shape, np.int64)
            return _State(occupancy, inferred, [label.astype(float) for label in maps], [nothing] * len(maps))
        filled = list(self.pool.map(lambda index: self._continued(occupancy, index), views))
        return _State(occupancy, inferred, filled, [_base(surface, self.labels) for surface in filled])

    def _grow_arms(self, windows: Sequence[Window]) -> None:
        """Find arms for these windows alone; what an iteration before has found is kept."""
        wanted = list(product(range(len(self.array)), windows))
        missing = [task for task in wanted if task not in self.arms]
        grown = self.pool.map(lambda task: cross_arms(self.array[task[0]].image, task[1]), missing)
        found = self.arms | dict(zip(missing, grown, strict=True))
        self.arms = {task: found[task] for task in wanted}

    def _inferred(self, state: _State | None, index: int, strip: slice) -> Inferred:
        """Labels of a strip of a view (2.13)."""
        settings, view = self.settings, self.array[index]
        iteration = 0 if state is None else 1
        rows = slice(max(strip.start - OVERLAP_ROWS, 0), min(strip.stop + OVERLAP_ROWS, view.shape[0]))
        base = np.zeros(view.shape, np.int64) if state is None else state.bases[index]
        windows = settings.windows(iteration)
        arms = [self.arms[index, window] for window in windows]
        explicit = state is not None and settings.occlusion == "explicit"
        occupancy = state.occupancy if state is not None and explicit else None
        origin = base - self.half_band if self.is_large else np.zeros(view.shape, np.int64)
        regions = Regions(arms, windows, base, Band(origin, self.num_labels))
        comparison = replace(self.comparison, smaller_of_opposite=settings.takes_smaller(iteration))
        cost = photometric_cost(comparison, index, self.near[index], regions, occupancy, rows)
        if state is not None and settings.geometric_weight > 0.0:
            label, kept = (plane[rows] for plane in state.occupancy[index])
            strength = np.float32(settings.geometric_weight)
            _kernels.add_distance(label, kept, origin[rows], strength, settings.geometric_limit, cost)
        found = settings.inference_method(iteration, self.comparison.fineness).infer(
            cost, view.image[rows], base[rows], origin[rows]
        )
        np.clip(found.label, 0, self.labels.num_labels - 1, out=found.label)
        return found.rows(slice(strip.start - rows.start, strip.stop - rows.start))

    def _continued(self, occupancy: Sequence[Occupancy], index: int) -> Floats:
        other = self.near[index].all[0]
        pair = self.array[index].position, self.array[other].position
        image = self.array[index].image
        fine = self.comparison.fineness
        return continued(occupancy[index], occupancy[other], self.labels, pair, image, fine)

    def surfaces(self, state: _State) -> tuple[Surface, ...]:
        """Turn labels into disparities; what no camera agrees on counts as occluded."""
        views = range(len(self.array))
        found = list(self.pool.map(partial(self._refined, state), views))
        if self.settings.occlusion == "explicit" and self.settings.filling == "continued":
            for _ in range(FUSION_ROUNDS):
                found = list(self.pool.map(partial(fused, self.array, self.labels, found), views))
        final = [np.floor(label + 0.5).astype(np.int64) for label in found]

        def _surface(index: int) -> Surface:
            seen = seen_elsewhere(self.array, self.labels, final, index)
            sure = confidence(evidence(self.array, self.labels, final, index))
            return Surface(self.labels.disparity(found[index]).astype(np.float32), ~seen, sure)

        return tuple(self.pool.map(_surface, views))

    def _refined(self, state: _State, index: int) -> Floats:
        """Labels of a view, and what lies between them where that is asked for."""
        label = state.filled[index]
        if not self.settings.sub_pixel:
            return label
        kept = state.occupancy[index].supported
        between = label + np.where(kept, state.inferred[index].offset, 0.0)
        refined, fine = np.empty(label.shape), self.comparison.fineness
        labels = PLANE_TOLERANCE_PX * fine, MOST_REFINED_PX * fine
        window = PLANE_RADIUS_PX, PLANE_SPACING_PX, labels[0], PLANE_LEVELS, CONTINUED_WEIGHT, STIFFNESS_PX2
        _kernels.fit_planes(
            between, kept, self.array[index].image, _kernels.PlaneWindow(*window, labels[1]), refined
        )
        return np.clip(refined, 0.0, self.labels.num_labels - 1.0)


def _half_band(fine: float) -> int:
    return round(HALF_BAND_PX * fine)


def _is_large(shape: tuple[int, int], num_labels: int, band: int) -> bool:
    """Whether half the size tells first which labels are tried, if these are fewer than all."""
    return shape[0] * shape[1] * num_labels > LARGE_CELLS and min(shape) > 1 and band < num_labels


def _halved(num_labels: int) -> int:
    """Labels of views of half the size: the same step, half the range."""
    return num_labels // 2 + 1


def _half_range(labels: DisparityLabels) -> DisparityLabels:
    return DisparityLabels(0.5 * labels.lowest, labels.step, _halved(labels.num_labels))


def _strips(shape: tuple[int, int], num_labels: int) -> list[slice]:
    """Cut the rows of a view; a strip with its overlap is at most of `MAX_CELLS`, if it can be."""
    height, width = shape
    rows = max(MAX_CELLS // (width * num_labels) - 2 * OVERLAP_ROWS, OVERLAP_ROWS)
    if height * width * num_labels <= MAX_CELLS:
        rows = height
    count = -(-height // rows)
    edges = [height * k // count for k in range(count + 1)]
    return [slice(*pair) for pair in pairwise(edges)]


def _half(view: ArrayView) -> ArrayView:
    """Halve a view; its first pixel centre is between the first four."""
    height, width = (size - size % 2 for size in view.shape)
    quarters = view.image[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).astype(np.uint16)
    image = ((quarters.sum(axis=(1, 3)) + 2) // 4).astype(np.uint8)
    if view.valid is None:
        return ArrayView(view.name, image, view.position)
    valid = np.logical_and.reduce([view.valid[dy:height:2, dx:width:2] for dy in (0, 1) for dx in (0, 1)])
    return ArrayView(view.name, image, view.position, valid)


def _doubled(filled: Floats, shape: tuple[int, int], labels: DisparityLabels) -> Floats:
    """Bring labels of a half-sized view to the full size: disparities double, steps do not."""
    doubled = np.clip(2.0 * filled, 0.0, labels.num_labels - 1.0)
    return _repeated(doubled, shape)


def _repeated(plane: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    repeated = plane.repeat(2, axis=0).repeat(2, axis=1)
    missing = [(0, max(size - done, 0)) for size, done in zip(shape, repeated.shape, strict=True)]
    return np.pad(repeated, missing, mode="edge")


def _joined(parts: Sequence[Inferred], strips: Sequence[slice]) -> Inferred:
    assert len(parts) == len(strips)
    label = np.concatenate([part.label for part in parts])
    return Inferred(label, np.concatenate([part.offset for part in parts]))


def _base(filled: Floats, labels: DisparityLabels) -> Labels:
    """Round a surface to labels, without single wrong ones."""
    smooth = cv2.medianBlur(filled.astype(np.float32), BASE_MEDIAN_PX)
    base: Labels = np.clip(np.floor(smooth + 0.5), 0, labels.num_labels - 1).astype(np.int64)
    return base


def _changed(before: _State, after: _State) -> float:
    """Share of all pixels whose label has changed by more than one."""
    pairs = zip(before.filled, after.filled, strict=True)
    return float(np.mean([(np.abs(a - b) > 1.0).mean() for a, b in pairs]))
