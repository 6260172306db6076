"""Decoded frames and correlation noise of a few points, small enough to lie in the page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.rd.curves import Curve, Experiment
from dvc.rd.pictures import read_picture
from dvc.rd.point_result import PointResult, number
from dvc.web.document import data_uri

MAX_POINTS = 40
NOISE_GAIN = 4
WEBP_QUALITY = 90
MIN_QUALITY = 60
Picture = NDArray[np.uint8]


@dataclass
class Gallery:
    """Pictures of a report."""

    sources: list[str] = field(default_factory=list)  # data URIs, each once
    # by slug of the experiment: ``label`` and ``point`` of the curve, ``index`` of the frame, and where its
    # ``original``, ``decoded`` and ``noise`` (or None) stand in `sources`
    shown: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    num_left_out: int = 0  # points whose pictures have no room
    num_missing: int = 0  # points whose pictures are damaged or not there

    @property
    def num_points(self) -> int:
        """Points with pictures."""
        return sum(len(entries) for entries in self.shown.values())


def build_gallery(found: Sequence[Experiment], max_bytes: int) -> Gallery:
    """Encode the pictures of a few points of every curve."""
    wanted = list(_by_importance(found))
    chosen = wanted[:MAX_POINTS]
    for quality in range(WEBP_QUALITY, MIN_QUALITY - 1, -10):
        gallery = _encoded(chosen, quality)
        if sum(map(len, gallery.sources)) <= max_bytes:
            break
    else:
        while chosen and sum(map(len, gallery.sources)) > max_bytes:
            chosen = chosen[: len(chosen) * 2 // 3]
            gallery = _encoded(chosen, MIN_QUALITY)
    with_pictures = [
        point for one in found for curve in one.curves for point in curve.points if _has_pictures(point)
    ]
    gallery.num_left_out = len(with_pictures) - len(chosen)
    for entries in gallery.shown.values():
        entries.sort(key=lambda entry: (entry["curve"], entry["point"]))
    return gallery


def _by_importance(found: Sequence[Experiment]) -> Iterator[tuple[Experiment, Curve, int]]:
    """Yield points with pictures: the middle of each curve, then the ends."""
    for rank in range(3):
        for one in found:
            for curve in one.curves:
                numbers = [i for i, point in enumerate(curve.points) if _has_pictures(point)]
                if not numbers:
                    continue
                ends = dict.fromkeys((numbers[len(numbers) // 2], numbers[0], numbers[-1]))
                if rank < len(ends):
                    yield one, curve, list(ends)[rank]


def _has_pictures(point: PointResult) -> bool:
    pictures = point.data.get("pictures")
    return isinstance(pictures, dict) and all(
        isinstance(pictures.get(name), str) for name in ("original", "decoded")
    )


def _encoded(chosen: Sequence[tuple[Experiment, Curve, int]], quality: int) -> Gallery:
    gallery = Gallery()
    places: dict[bytes, int] = {}
    for one, curve, number_ in chosen:
        pictures = curve.points[number_].data["pictures"]
        original, decoded = _read(pictures["original"]), _read(pictures["decoded"])
        if original is None or decoded is None or original.shape != decoded.shape:
            gallery.num_missing += 1
            continue
        noise = _noise(original, _read(pictures.get("predicted")))
        entry: dict[str, Any] = {"curve": one.curves.index(curve), "label": curve.label, "point": number_}
        entry |= {"index": _index(curve.points[number_]), "type": _type(curve.points[number_])}
        entry |= {"width": original.shape[1], "height": original.shape[0]}
        for kind, plane in (("original", original), ("decoded", decoded), ("noise", noise)):
            entry[kind] = None if plane is None else _place(plane, quality, gallery, places)
        gallery.shown.setdefault(one.slug, []).append(entry)
    return gallery


def _place(plane: Picture, quality: int, gallery: Gallery, places: dict[bytes, int]) -> int:
    """Return where a picture stands; equal pictures stand once."""
    import cv2

    key = plane.tobytes()
    if key not in places:
        _, coded = cv2.imencode(".webp", plane, [cv2.IMWRITE_WEBP_QUALITY, quality])
        places[key] = len(gallery.sources)
        gallery.sources.append(data_uri("image/webp", coded.tobytes()))
    return places[key]


def _read(name: object) -> Picture | None:
    return read_picture(Path(name)) if isinstance(name, str) else None


def _noise(original: Picture, predicted: Picture | None) -> Picture | None:
    """Return original minus prediction, amplified, grey where they are equal."""
    if predicted is None or predicted.shape != original.shape:
        return None
    difference = NOISE_GAIN * (original.astype(np.int32) - predicted) + 128
    return np.asarray(np.clip(difference, 0, 255), dtype=np.uint8)


def _index(point: PointResult) -> int:
    return int(number(point.data["pictures"].get("index")) or 0)


def _type(point: PointResult) -> str:
    types = {row.get("index"): row.get("type") for row in point.frame_rows}
    names = {"wz": "Wyner-Ziv", "key": "key", "intra": "intra", "inter": "inter"}
    return names.get(str(types.get(point.data["pictures"].get("index"))), "")
