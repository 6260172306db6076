"""Layered depth image (2.21): the surfaces of all cameras in the frame of one, several values a pixel.

Surfaces are sheared into the frame of the reference camera as points. Choices that (2.21) leaves open:

* A pixel votes unless a neighbouring camera refutes it, by seeing through it (2.15); of each camera, only the
  nearest remaining point of a pixel votes.
* The label with most votes is a value, the larger one of equals; its disparity is the mean of its voters, its
  colour their median, or inside the frame that of the reference view. Points within `resolution` are removed
  with it, unless a camera itself sees both surfaces, a label and a pixel or more apart.
* Inside the frame nothing lies before the first value; the surface of the reference lies in no deeper one.
"""

# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.array_files import MAX_NUMBER, MIN_STEP
from dvc.arrays import Bytes, Floats, Integers, Mask, Singles
from dvc.errors import DvcError
from dvc.geometry.camera_array import CameraArray, DisparityLabels, Reconstruction
from dvc.layers.canvas import Canvas, Frame, sort_points, splat, world_from_reference

MAX_LAYERS = 8
"""Largest number of values at a pixel; more are errors of the surfaces."""
MIN_HIDDEN_REGION_PX = 20
"""Smallest region behind two other surfaces; smaller ones are artefacts at their borders."""
MAX_CANVAS_FRAMES = 16
"""Largest ratio of the areas of the canvas and a view."""
MAX_POINTS_PER_PIXEL = MAX_CANVAS_FRAMES
"""Largest average number of points per pixel of all views: surfaces without folds have one."""
_ROWS = 64
"""Rows of the canvas in one vote."""
REFUTED, HIDDEN, CONFIRMED = range(3)
"""Verdicts of a camera on a surface."""
JUST_BELOW = 0.999
"""Factor on limits that rounding may miss."""


@dataclass(frozen=True, eq=False)
class LayeredDepthImage:
    """Values of disparity and colour, several a pixel, from near to far.

    Attributes
    ----------
    canvas : Canvas
        Their canvas.
    colour : ndarray of shape (L, H, W, 3), uint8
        Red, green and blue.
    disparity : ndarray of shape (L, H, W), float32
        In pixels per unit of m, strictly decreasing from layer to layer; 0 without a value.
    votes : ndarray of shape (L, H, W), uint8
        Number of cameras that agree on each value, at most 255; 0 for none. A pixel with a value in a layer
        has one in all layers before it.
    """

    canvas: Canvas
    colour: Bytes
    disparity: Singles
    votes: Bytes

    @property
    def occupied(self) -> Mask:
        """Mask of values, of shape (L, H, W)."""
        return self.votes > 0

    @property
    def values_per_pixel(self) -> Integers:
        """Number of values of each pixel, of shape (H, W)."""
        return np.asarray(np.count_nonzero(self.votes, axis=0), np.int64)

    def counts(self) -> dict[str, Any]:
        """Count layers, and values inside the reference frame, of each layer there, and beyond it."""
        frame = self.canvas.frame
        inside = self.occupied[:, *frame.slices]
        num_inside = int(inside.sum())
        return {
            "num_layers": len(self.votes),
            "num_values_inside": num_inside,
            "num_values_beyond": int(self.occupied.sum()) - num_inside,
            "increase_percent": round(100.0 * (num_inside / (frame.width * frame.height) - 1.0), 3),
            "num_values_by_layer": [int(layer.sum()) for layer in inside],
        }


def resolution(array: CameraArray, labels: DisparityLabels) -> float:
    """Return the smallest difference of disparity between distinct surfaces."""
    positions = np.array([view.position for view in array])
    span = float(np.ptp(positions, axis=0).max())
    return max(labels.step, 1.0 / span) if span > 0.0 else labels.step


def unrefuted(reconstruction: Reconstruction) -> list[Mask]:
    """Return masks of the pixels that no neighbouring camera refutes, after (2.15)."""
    array, surfaces = reconstruction.array, reconstruction.surfaces
    tolerance = 1.001 * resolution(array, reconstruction.labels)
    masks = []
    for index, (view, surface) in enumerate(zip(array, surfaces, strict=True)):
        mask = view.seen.copy()
        for pair in _neighbours(array, index):
            best, worst = np.zeros(array.shape, np.uint8), np.full(array.shape, CONFIRMED, np.uint8)
            for other in pair:
                dm, dn = np.subtract(array[other].position, view.position)
                verdict = judge(surface.disparity, surfaces[other].disparity, dm, dn, tolerance)
                best, worst = np.maximum(best, verdict), np.minimum(worst, verdict)
            mask &= (best == CONFIRMED) | (worst > REFUTED)
        masks.append(mask)
    return masks


@kernel
def judge(disparity, other, dm, dn, tolerance):
    """Return the verdicts on a surface of another camera, (dm, dn) away."""
    height, width = disparity.shape
    verdict = np.empty((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            d = disparity[y, x]
            u, v = x - dm * d, y - dn * d
            left, top = int(np.floor(u + 1e-6)), int(np.floor(v + 1e-6))
            right, bottom = int(np.ceil(u - 1e-6)), int(np.ceil(v - 1e-6))
            seen = HIDDEN if right < 0 or left >= width or bottom < 0 or top >= height else REFUTED
            for row in range(max(top, 0), min(bottom, height - 1) + 1):
                for column in range(max(left, 0), min(right, width - 1) + 1):
                    difference = other[row, column] - d
                    if abs(difference) <= tolerance:
                        seen = CONFIRMED
                    elif difference > 0.0 and seen == REFUTED:
                        seen = HIDDEN
            verdict[y, x] = seen
    return verdict


def _neighbours(array: CameraArray, index: int) -> list[list[int]]:
    """Return the nearest cameras to the left and right, and above and below, if any."""
    nearest: dict[tuple[int, bool], tuple[float, int]] = {}
    for other in range(len(array)):
        if other != index:
            offset = np.subtract(array[other].position, array[index].position)
            axis = int(abs(offset[1]) > abs(offset[0]))
            if abs(offset[1 - axis]) > 0.5 * abs(offset[axis]):
                continue
            side = axis, bool(offset[axis] > 0.0)
            nearest[side] = min(nearest.get(side, (np.inf, -1)), (float(offset @ offset), other))
    pairs = [[other for (side, _), (_, other) in nearest.items() if side == axis] for axis in (0, 1)]
    return [pair for pair in pairs if pair]


def layered_depth_image(
    reconstruction: Reconstruction,
    voters: Sequence[Mask] | None = None,
    *,
    advance: Callable[[int], None] = lambda _: None,
) -> LayeredDepthImage:
    """Merge the surfaces of all cameras in the frame of the reference, (2.21).

    Parameters
    ----------
    reconstruction : Reconstruction
        Surfaces of at least one view.
    voters : sequence of ndarray of shape (H, W), bool, optional
        Which pixels of each camera vote; by default those that no neighbouring camera refutes. All pixels
        of the reference vote.
    advance : callable, optional
        Called with the number of finished steps; the total is the number of views.

    Returns
    -------
    LayeredDepthImage
        On the smallest canvas that holds the reference frame and all values.

    Raises
    ------
    DvcError
        If magnitudes are out of range, the canvas would be larger than `MAX_CANVAS_FRAMES` views, or views
        have more than `MAX_POINTS_PER_PIXEL`.
    """
    array, labels = reconstruction.array, reconstruction.labels
    largest = max(float(np.abs(surface.disparity).max()) for surface in reconstruction.surfaces)
    farthest = float(np.abs([view.position for view in array]).max())
    if not (MIN_STEP <= labels.step <= MAX_NUMBER and max(largest, farthest) <= MAX_NUMBER):
        sizes = f"disparities up to {largest:g} in steps of {labels.step:g}"
        raise DvcError(f"{sizes}, or positions of cameras, are out of range")
    reference = array[array.reference]
    masks = unrefuted(reconstruction) if voters is None else list(voters)
    masks[array.reference] = reference.seen
    positions = np.array([np.subtract(view.position, reference.position) for view in array], np.float64)
    canvas = _canvas(reconstruction, masks, positions)
    corner, jump = (-canvas.frame.left, -canvas.frame.top), 1.001 * canvas.resolution

    def _enter(next_free: Integers, points: Singles, cameras: NDArray[np.int16]) -> None:
        for camera, (surface, mask) in enumerate(zip(reconstruction.surfaces, masks, strict=True)):
            m, n = positions[camera]
            target = m, n, corner, canvas.shape, jump, camera
            splat(surface.disparity, mask, *target, next_free, points, cameras)
            if points.size:
                advance(1)

    counts = np.zeros(canvas.shape[0] * canvas.shape[1], np.int64)
    _enter(counts, np.empty(0, np.float32), np.empty(0, np.int16))
    starts = np.concatenate([[0], np.cumsum(counts)])
    num_pixels = sum(surface.disparity.size for surface in reconstruction.surfaces)
    if starts[-1] > MAX_POINTS_PER_PIXEL * num_pixels:
        raise DvcError(
            f"surfaces of {num_pixels} pixels have {starts[-1]} points; "
            f"at most {MAX_POINTS_PER_PIXEL} a pixel are accepted"
        )
    points, cameras = np.empty(starts[-1], np.float32), np.empty(starts[-1], np.int16)
    _enter(starts[:-1].copy(), points, cameras)
    sort_points(starts, points, cameras)
    reach, images = round(canvas.resolution / labels.step), np.stack([view.image for view in array])
    (height, width), frame, strips = canvas.shape, canvas.frame, []
    for top in range(0, height, _ROWS):
        shape = MAX_LAYERS, min(_ROWS, height - top), width
        layers = np.zeros(shape, np.float32), np.zeros(shape, np.uint8), np.zeros((*shape, 3), np.uint8)
        inside = frame.left, frame.top - top, frame.left + frame.width, frame.top + frame.height - top
        cells = starts[top * width : (top + shape[1]) * width + 1], points, cameras
        levels = labels.lowest, labels.step, reach
        vote(*cells, *levels, positions, images, inside, array.reference, layers)
        num_layers = max(1, int(layers[1].any(axis=(1, 2)).sum()))
        strips.append([values[:num_layers] for values in layers])
    num_layers, whole = max(len(strip[0]) for strip in strips), []
    for parts in zip(*strips, strict=True):
        deeper = [(0, 0)] * (parts[0].ndim - 1)
        padded = [np.pad(part, [(0, num_layers - len(part)), *deeper]) for part in parts]
        whole.append(np.concatenate(padded, axis=1))
    colour, disparity, votes = _without_strays(whole[2], whole[0], whole[1])
    colour[0, *canvas.frame.slices][reference.seen] = reference.image[reference.seen]
    return LayeredDepthImage(canvas, colour, disparity, votes)


def _canvas(reconstruction: Reconstruction, masks: list[Mask], positions: Floats) -> Canvas:
    """Return the smallest canvas that holds the reference view and all voters."""
    array, labels = reconstruction.array, reconstruction.labels
    height, width = array.shape
    low, high = np.zeros(2), np.array([width - 1.0, height - 1.0])
    for surface, mask, position in zip(reconstruction.surfaces, masks, positions, strict=True):
        if mask.any():
            y, x = np.nonzero(mask)
            targets = np.stack([x, y]) + position[:, None] * surface.disparity[mask].astype(np.float64)
            low, high = np.minimum(low, targets.min(axis=1)), np.maximum(high, targets.max(axis=1))
    size = np.floor(high + 0.5) - np.floor(low + 0.5) + 1.0
    if not size.prod() <= MAX_CANVAS_FRAMES * width * height:
        raise DvcError(
            f"surfaces of {width}x{height} pixels spread over {size[0]:g}x{size[1]:g}; "
            f"at most {MAX_CANVAS_FRAMES} times a view is accepted"
        )
    left, top = (int(value) for value in np.floor(low + 0.5))
    shape, frame = (int(size[1]), int(size[0])), Frame(-left, -top, width, height)
    settings = labels, resolution(array, labels), array[array.reference].name, len(array)
    return Canvas(shape, frame, *settings, world_from_reference(reconstruction))


def _without_strays(colour: Bytes, disparity: Singles, votes: Bytes) -> tuple[Bytes, Singles, Bytes]:
    """Drop small regions behind two other surfaces, and empty layers."""
    for layer in range(len(votes) - 1, 1, -1):
        _, region, sizes, _ = cv2.connectedComponentsWithStats((votes[layer] > 0).astype(np.uint8))
        stray = (votes[layer] > 0) & (sizes[region, cv2.CC_STAT_AREA] < MIN_HIDDEN_REGION_PX)
        for values in (colour, disparity, votes):
            values[layer:-1, stray] = values[layer + 1 :, stray]
            values[-1, stray] = 0
    depth = max(1, int(votes.any(axis=(1, 2)).sum()))
    return colour[:depth], disparity[:depth], votes[:depth]


@kernel
def vote(starts, points, cameras, lowest, step, reach, positions, images, frame, reference, layers):
    """Peel the values of every cell (2.21): disparity, votes, and the median colour of the voters."""
    disparity, votes, colour = layers
    width = disparity.shape[2]
    longest = 1
    for cell in range(starts.size - 1):
        longest = max(longest, starts[cell + 1] - starts[cell])
    levels, samples = np.empty(longest, np.int64), np.empty((positions.shape[0], 3))
    alive, chosen = np.empty(longest, np.bool_), np.empty(longest, np.bool_)
    seen = np.empty(positions.shape[0], np.bool_)
    left, top, right, bottom = frame
    baselines = np.maximum(np.abs(positions[:, 0]), np.abs(positions[:, 1]))
    for cell in range(starts.size - 1):
        start, count = starts[cell], starts[cell + 1] - starts[cell]
        row, column = cell // width, cell % width
        in_frame = top <= row < bottom and left <= column < right
        d, c = points[start : start + count], cameras[start : start + count]
        for i in range(count):
            levels[i], alive[i] = int(np.floor((d[i] - lowest) / step + 0.5)), True
        for layer in range(disparity.shape[0]):
            owner = reference if in_frame and layer == 0 else -1
            value, number = peel(d, c, levels, step, reach, baselines, owner, seen, alive, chosen)
            if number == 0:
                break
            slot = layer
            while slot > 0 and disparity[slot - 1, row, column] < value:
                disparity[slot, row, column] = disparity[slot - 1, row, column]
                votes[slot, row, column] = votes[slot - 1, row, column]
                colour[slot, row, column] = colour[slot - 1, row, column]
                slot -= 1
            disparity[slot, row, column], votes[slot, row, column] = value, min(number, 255)
            number = 0
            for i in range(count):
                if chosen[i]:
                    x = column - left - positions[c[i], 0] * d[i]
                    y = row - top - positions[c[i], 1] * d[i]
                    _sample(images[c[i]], x, y, samples[number])
                    number += 1
            for channel in range(3):
                median = np.median(samples[:number, channel])
                colour[slot, row, column, channel] = int(np.floor(median + 0.5))


@kernel
def peel(points, cameras, levels, step, reach, baselines, owner, seen, alive, chosen):
    """Choose the next value of a cell by (2.21), and remove its points and impossible ones from `alive`."""
    seen[:] = False
    best, most, best_sum = 0, 0, 0.0
    level, run, total = 0, 0, 0.0
    for i in range(points.size):
        chosen[i] = alive[i] and not seen[cameras[i]]
        if not chosen[i]:
            continue
        seen[cameras[i]] = True
        if run == 0 or levels[i] != level:
            level, run, total = levels[i], 0, 0.0
        run, total = run + 1, total + points[i]
        if run > most or (run == most and level == best):
            best, most, best_sum = level, run, total
    votes, value = 0, best_sum / max(most, 1)
    for i in range(points.size):
        near = alive[i] and abs(levels[i] - best) <= reach
        behind = value - points[i]
        hidden = behind > JUST_BELOW * step and behind * baselines[cameras[i]] > JUST_BELOW and not chosen[i]
        chosen[i] = chosen[i] and near
        votes += chosen[i]
        alive[i] = alive[i] and cameras[i] != owner and (not near or hidden)
        alive[i] = alive[i] and (owner < 0 or levels[i] <= best)
    return value, votes


@kernel
def _sample(image, x, y, sample):
    """Interpolate a picture linearly, with a repeated border."""
    height, width = image.shape[:2]
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    left, top = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
    s, t = x - left, y - top
    for channel in range(3):
        above = (1.0 - s) * image[top, left, channel] + s * image[top, right, channel]
        below = (1.0 - s) * image[bottom, left, channel] + s * image[bottom, right, channel]
        sample[channel] = (1.0 - t) * above + t * below
