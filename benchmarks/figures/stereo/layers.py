"""Layered depth images of Tsukuba, and the sprites that they are cut into."""

from functools import partial

import numpy as np

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.stereo.runs import reconstructed
from dvc.stereo.layers.layered_depth_image import layered_depth_image
from dvc.stereo.layers.sprites import composite, extract_sprites
from dvc.stereo.thesis.real_sets import TSUKUBA

AREA = "stereo"
ASKED_PERCENT = {2: (2.0, 5.0), 5: (8.0, 15.0), 25: (15.0, 25.0)}
THESIS_PERCENT = {2: 2.1, 5: 9.7, 25: 19.4}
ASKED_LAYERS = {25: 3}


def increase(setting: Setting, clip: str, num_cameras: int) -> Measured:
    """Count the values of the layered depth image of Tsukuba, as table 2.3."""
    del setting, clip
    counts = layered_depth_image(reconstructed(TSUKUBA, num_cameras)).counts()
    low, high = ASKED_PERCENT[num_cameras]
    holds = low <= counts["increase_percent"] <= high
    holds &= counts["num_layers"] == ASKED_LAYERS.get(num_cameras, counts["num_layers"])
    by_layer = " + ".join(map(str, counts["num_values_by_layer"]))
    text = (
        f"{counts['increase_percent']:+.1f} %, {counts['num_layers']} layers ({by_layer}), "
        f"{counts['num_values_beyond']} beyond the frame"
    )
    return Measured(text, holds, counts)


def sprites(setting: Setting, clip: str) -> Measured:
    """Cut the layered depth image of Tsukuba into sprites, and put them together again."""
    del clip
    found = reconstructed(TSUKUBA, setting.choose(25, 2))
    image = layered_depth_image(found)
    cut = extract_sprites(image)
    times = np.zeros(image.votes.shape, np.int64)
    for sprite in cut.sprites:
        here = image.occupied[:, *sprite.slices] & (image.disparity[:, *sprite.slices] == sprite.disparity)
        times[:, *sprite.slices] += sprite.mask & here
    once = int((times == 1)[image.occupied].sum())
    colour, _, _ = composite(cut)
    reference = found.array[found.array.reference].image
    same = int((colour[image.canvas.frame.slices] == reference).all(axis=2).sum())
    num_values, num_pixels = int(image.occupied.sum()), reference.shape[0] * reference.shape[1]
    text = (
        f"{once} of {num_values} values, {same} of {num_pixels} pixels; {len(cut.sprites)} sprites, "
        f"the largest of {max(sprite.num_values for sprite in cut.sprites)} values"
    )
    in_sprites = sum(sprite.num_values for sprite in cut.sprites)
    holds = once == num_values == in_sprites and same == num_pixels
    values = {"num_sprites": len(cut.sprites), "num_values": num_values, "num_pixels_back": same}
    return Measured(text, holds, values)


def _asked(num_cameras: int) -> str:
    low, high = ASKED_PERCENT[num_cameras]
    layers = f", {ASKED_LAYERS[num_cameras]} layers" if num_cameras in ASKED_LAYERS else ""
    return f"+{low:g} to +{high:g} %{layers}"


FIGURES = (
    *(
        Figure(
            AREA,
            f"layers-{cameras}-cameras",
            f"values of the layered image of Tsukuba over one depth map, {cameras} cameras (table 2.3)",
            _asked(cameras),
            partial(increase, num_cameras=cameras),
            thesis=f"+{THESIS_PERCENT[cameras]:g} %" + (", 3 layers" if cameras in ASKED_LAYERS else ""),
            slow=cameras == 25,
        )
        for cameras in ASKED_PERCENT
    ),
    Figure(
        AREA,
        "sprites",
        "values in exactly one sprite; pixels of the reference view that all sprites give back; Tsukuba",
        "all of both",
        sprites,
    ),
)
"""The figures of this module."""
