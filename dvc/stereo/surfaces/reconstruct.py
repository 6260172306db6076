"""Surfaces of all cameras of an array: from costs to surfaces to occupancy to visibility and back.

Each iteration infers the labels of every camera from its photometric cost (2.13), keeps the surfaces on which
several cameras agree (2.15), and continues them over the rest. The next one takes visibility from these
surfaces (2.17), and its windows follow them. In the end the surfaces of all cameras are fused.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, pairwise, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats
from dvc.errors import ConfigError
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, Reconstruction, Surface
from dvc.geometry.label_inference import Inferred
from dvc.geometry.matching_costs import COSTS, Arms, Band, MatchingCost, Window, cross_arms
from dvc.stereo.surfaces.occupancy import (
    EXPOSURE_RATIO,
    Comparison,
    Labels,
    Occupancy,
    add_distance,
    fineness,
    gains,
    neighbours,
    photometric_cost,
    seen_elsewhere,
    supported,
    with_gains,
)
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from dvc.stereo.surfaces.surface_completion import (
    FUSION_ROUNDS,
    confidence,
    continued,
    evidence,
    fitted_planes,
    fused,
)

MAX_CELLS = 24_000_000
"""Largest number of pixels times labels in one inference; larger views are cut into strips of rows."""
MAX_STRIP_CELLS = 128_000_000
"""Largest strip with its overlap; a cell takes about 32 bytes in every thread, 4 GiB in all."""
LARGE_CELLS = 40_000_000
"""Cells of a view above which half the size first restricts the labels to try."""
HALF_BAND_PX, BAND_ITERATIONS = 5, 2
"""Parallax to try at each pixel on both sides of that of the half size, and number of iterations."""
OVERLAP_ROWS = 80
"""Overlap of strips: the reach of the arms of pixels."""
BASE_MEDIAN_PX = 5
"""Side of the median that removes single wrong labels from a base surface."""
MIN_SIDE_PX, EXPOSURE_ROUNDS = 120, 2
"""Shorter side of the halved views for exposures, and number of comparisons of exposures."""

DEFAULT_SETTINGS = StereoSettings()


@dataclass(frozen=True, eq=False)
class _State:
    """State of the scene between two iterations."""

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
    """Reconstruct the surfaces of all views.

    Parameters
    ----------
    array : CameraArray
        At least two views.
    labels : DisparityLabels
        Disparities to try.
    settings : StereoSettings, optional
        Settings.
    jobs : int, optional
        Threads; the result is the same for any number.
    advance : callable, optional
        Called with the number of finished views of an iteration; the total is at most `most_steps`.

    Returns
    -------
    Reconstruction
        A surface for each view.

    Raises
    ------
    ConfigError
        If labels are too many for the memory that the inference of such wide views needs.
    """
    with ThreadPoolExecutor(jobs) as pool:
        solver = _Solver(array, labels, settings, pool, advance)
        solver = solver.equally_exposed() if settings.exposures else solver
        state, changes = solver.solve()
        surfaces = solver.surfaces(state)
    figures = {"iterations": len(changes), "changed": [round(change, 6) for change in changes]}
    return Reconstruction(array, labels, surfaces, figures)


def most_steps(array: CameraArray, labels: DisparityLabels, settings: StereoSettings) -> int:
    """Return the number of steps of `reconstruct` if no iteration ends early."""
    (height, width), num_labels = array.shape, labels.num_labels
    iterations, band = settings.max_iterations, 2 * round(HALF_BAND_PX * fineness(array, labels)) + 1
    while _is_large((height, width), num_labels, band):
        height, width, num_labels = height // 2, width // 2, num_labels // 2 + 1
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
        self.fine = fineness(array, labels)
        self.half_band = round(HALF_BAND_PX * self.fine)
        band = 2 * self.half_band + 1
        self.is_large = _is_large(array.shape, labels.num_labels, band)
        self.num_labels = band if self.is_large else labels.num_labels
        # strips of at most `MAX_CELLS` with their overlap, if possible
        (height, width), cells = array.shape, array.shape[1] * self.num_labels
        rows = max(MAX_CELLS // cells - 2 * OVERLAP_ROWS, OVERLAP_ROWS)
        count = 1 if height * cells <= MAX_CELLS else -(-height // rows)
        edges = [height * k // count for k in range(count + 1)]
        self.strips = [slice(*pair) for pair in pairwise(edges)]
        if min(edges[1] + 2 * OVERLAP_ROWS, height) * cells > MAX_STRIP_CELLS:
            raise ConfigError(
                f"{labels.num_labels} disparities in steps of {labels.step:g} px are too many for the memory "
                f"that views {width} pixels wide need: larger steps or smaller views are accepted"
            )

    def equally_exposed(self) -> "_Solver":
        """Bring all views to the exposure of the reference, from surfaces of small views."""
        small, labels, array = self.array, self.labels, self.array
        while min(small.shape) >= 2 * MIN_SIDE_PX:
            small, labels = CameraArray(tuple(map(_half, small))), _half_range(labels)
        once = replace(self.settings, max_iterations=1)
        for _ in range(EXPOSURE_ROUNDS):
            solver = _Solver(small, labels, once, self.pool, lambda _: None)
            solver.comparison = replace(solver.comparison, cost=MatchingCost("bits"))
            factors = gains(small, labels, solver.solve()[0].occupancy[small.reference])
            if max(factors.max(), 1.0 / factors.min()) <= EXPOSURE_RATIO:
                break
            small, array = with_gains(small, factors), with_gains(array, factors)
        return _Solver(array, self.labels, self.settings, self.pool, self.advance)

    def solve(self) -> tuple[_State, list[float]]:
        """Iterate until nothing changes; return the last state, and the changed share of each iteration."""
        state: _State | None = None
        changes: list[float] = []
        if self.is_large:  # begin with the state of views of half the size; disparities double, steps do not
            labels, half = self.labels, CameraArray(tuple(map(_half, self.array)))
            solver = _Solver(half, _half_range(labels), self.settings, self.pool, self.advance)
            coarse, _ = solver.solve()
            doubled = [np.clip(2.0 * surface, 0.0, labels.num_labels - 1.0) for surface in coarse.filled]
            filled = [_repeated(surface, self.array.shape) for surface in doubled]
            bases = [_base(surface, labels) for surface in filled]
            near = [_repeated(occupancy.supported, self.array.shape) for occupancy in coarse.occupancy]
            state = _State([Occupancy(*pair) for pair in zip(bases, near, strict=True)], [], filled, bases)
        for _ in range(BAND_ITERATIONS if self.is_large else self.settings.max_iterations):
            after = self._iterated(state)
            pairs = [] if state is None else zip(state.filled, after.filled, strict=True)
            # share of all pixels with a change of more than one label
            changed = [(np.abs(a - b) > 1.0).mean() for a, b in pairs]
            changes.append(float(np.mean(changed)) if changed else 1.0)
            state = after
            if changes[-1] < self.settings.min_change:
                break
        assert state is not None
        return state, changes

    def _iterated(self, state: _State | None) -> _State:
        """Run one iteration over all cameras."""
        views = range(len(self.array))

        def _grown(task: tuple[int, Window]) -> Arms:
            return self.arms[task] if task in self.arms else cross_arms(self.array[task[0]].image, task[1])

        tasks = list(product(views, self.settings.windows(0 if state is None else 1)))
        self.arms = dict(zip(tasks, self.pool.map(_grown, tasks), strict=True))
        parts = self.pool.map(lambda task: self._inferred(state, *task), product(views, self.strips))
        inferred = []
        for _ in views:
            planes = [np.concatenate(plane) for plane in zip(*islice(parts, len(self.strips)), strict=True)]
            inferred.append(Inferred(*planes))
            self.advance(1)
        maps, exact = [view.label for view in inferred], self.settings.agreement == "exact"

        def _supported(index: int) -> Occupancy:
            return Occupancy(maps[index], supported(self.array, self.labels, maps, index, exact=exact))

        occupancy = list(self.pool.map(_supported, views))
        if self.settings.filling == "inferred":
            nothing = np.zeros(self.array.shape, np.int64)
            return _State(occupancy, inferred, [label.astype(float) for label in maps], [nothing] * len(maps))

        def _continued(index: int) -> Floats:
            other = self.near[index].all[0]
            pair = self.array[index].position, self.array[other].position
            image = self.array[index].image
            return continued(occupancy[index], occupancy[other], self.labels, pair, image, self.fine)

        filled = list(self.pool.map(_continued, views))
        return _State(occupancy, inferred, filled, [_base(surface, self.labels) for surface in filled])

    def _inferred(self, state: _State | None, index: int, strip: slice) -> Inferred:
        """Infer the labels of a strip of a view (2.13)."""
        settings, view = self.settings, self.array[index]
        iteration = 0 if state is None else 1
        rows = slice(max(strip.start - OVERLAP_ROWS, 0), min(strip.stop + OVERLAP_ROWS, view.shape[0]))
        base = np.zeros(view.shape, np.int64) if state is None else state.bases[index]
        windows = settings.windows(iteration)
        arms = [self.arms[index, window] for window in windows]
        occupancy = state.occupancy if state is not None and settings.occlusion == "explicit" else None
        origin = base - self.half_band if self.is_large else np.zeros(view.shape, np.int64)
        band, near = Band(origin, self.num_labels), self.near[index]
        comparison = replace(self.comparison, smaller_of_opposite=settings.takes_smaller(iteration))
        cost = photometric_cost(comparison, index, near, arms, windows, base, band, occupancy, rows)
        if state is not None and settings.geometric_weight > 0.0:
            label, mask = (plane[rows] for plane in state.occupancy[index])
            strength = np.float32(settings.geometric_weight)
            add_distance(label, mask, origin[rows], strength, settings.geometric_limit, cost)
        method = settings.inference_method(iteration, self.fine)
        inferred = method.infer(cost, view.image[rows], base[rows], origin[rows])
        np.clip(inferred.label, 0, self.labels.num_labels - 1, out=inferred.label)
        return inferred.rows(slice(strip.start - rows.start, strip.stop - rows.start))

    def surfaces(self, state: _State) -> tuple[Surface, ...]:
        """Turn labels into disparities; surfaces without agreement of a camera are occluded."""
        views, fine = range(len(self.array)), self.fine

        def _refined(index: int) -> Floats:
            supported = state.occupancy[index].supported
            between = state.filled[index] + np.where(supported, state.inferred[index].offset, 0.0)
            refined = fitted_planes(between, supported, self.array[index].image, fine)
            return np.clip(refined, 0.0, self.labels.num_labels - 1.0)

        maps = list(self.pool.map(_refined, views)) if self.settings.sub_pixel else state.filled
        if self.settings.occlusion == "explicit" and self.settings.filling == "continued":
            for _ in range(FUSION_ROUNDS):
                maps = list(self.pool.map(partial(fused, self.array, self.labels, maps), views))
        final = [np.floor(label + 0.5).astype(np.int64) for label in maps]

        def _surface(index: int) -> Surface:
            seen = seen_elsewhere(self.array, self.labels, final, index)
            sure = confidence(evidence(self.array, self.labels, final, index))
            return Surface(self.labels.disparity(maps[index]).astype(np.float32), ~seen, sure)

        return tuple(self.pool.map(_surface, views))


def _is_large(shape: tuple[int, int], num_labels: int, band: int) -> bool:
    """Return whether half the size first restricts the labels to try."""
    return shape[0] * shape[1] * num_labels > LARGE_CELLS and min(shape) > 1 and band < num_labels


def _half_range(labels: DisparityLabels) -> DisparityLabels:
    """Return the labels at half the size: the same step, half the range."""
    return DisparityLabels(0.5 * labels.lowest, labels.step, labels.num_labels // 2 + 1)


def _half(view: ArrayView) -> ArrayView:
    """Halve a view; its first pixel centre is between the first four."""
    height, width = (size - size % 2 for size in view.shape)
    quarters = view.image[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).astype(np.uint16)
    image = ((quarters.sum(axis=(1, 3)) + 2) // 4).astype(np.uint8)
    if view.valid is None:
        return ArrayView(view.name, image, view.position)
    valid = np.logical_and.reduce([view.valid[dy:height:2, dx:width:2] for dy in (0, 1) for dx in (0, 1)])
    return ArrayView(view.name, image, view.position, valid)


def _repeated(plane: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    repeated = plane.repeat(2, axis=0).repeat(2, axis=1)
    missing = [(0, max(size - done, 0)) for size, done in zip(shape, repeated.shape, strict=True)]
    return np.pad(repeated, missing, mode="edge")


def _base(filled: Floats, labels: DisparityLabels) -> Labels:
    """Round a surface to labels, without single outliers."""
    smooth = cv2.medianBlur(filled.astype(np.float32), BASE_MEDIAN_PX)
    return np.asarray(np.clip(np.floor(smooth + 0.5), 0, labels.num_labels - 1).astype(np.int64))
