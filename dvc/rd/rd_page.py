"""The report as one HTML file with charts, tables and decoded frames, which needs no network."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.rd.comparison import NOTHING, Verdict, rate_costs, verdicts
from dvc.rd.rd_curves import ANCHOR_LABEL, Curve, Experiment, experiments
from dvc.rd.rd_report import (
    RATE_COST_CAPTION,
    code_digests,
    curve_styles,
    number_text,
    points_cells,
    preface,
    psnrs_text,
    rate_cost_cells,
    rates_text,
)
from dvc.rd.rd_results import PointResult, mean
from dvc.web.document import SHARED, asset, data_uri, render_page, script_json, write_text
from dvc.web.gallery import Table
from dvc.web.plotting import MATPLOTLIB_DASHES

MAX_PAGE_BYTES = 8_000_000
MAX_PICTURE_BYTES = 6_000_000
MAX_PICTURE_SIDE_PX = 8192
MAX_FILE_BYTES = 2**27
MAX_POINTS = 40
"""Largest number of points with pictures."""
NOISE_GAIN = 4
WEBP_QUALITY, MIN_WEBP_QUALITY = 90, 60
TEMPLATES = resources.files("dvc.rd") / "templates"
SHARE_TITLES = {
    "key": "key frames",
    "intra": "intra frames",
    "inter": "inter frames",
    "parity": "parity",
    "crc": "check bits",
    "tracks": "tracks",
    "header": "headers",
    "stream": "whole stream",
}
_SYMBOLS = {"o": "circle", "s": "square", "^": "triangle-up", "D": "diamond", "v": "triangle-down"}
_SYMBOLS |= {"P": "cross", "x": "x-thin"}
"""Markers of Plotly, by those of matplotlib."""
_LETTERS = {"key": "k", "intra": "k", "wz": "w", "inter": "p"}
_TYPE_NAMES = {"wz": "Wyner-Ziv", "key": "key", "intra": "intra", "inter": "inter"}
_FRAME_COLUMNS = {
    "psnr": ("psnr_y_db", 2),
    "initial": ("si_psnr_y_db", 2),
    "refined": ("refined_si_psnr_y_db", 2),
    "requests": ("num_requests", 0),
    "decode": ("decode_s", 3),
}
"""Names in charts of the fields of frames, with the number of decimals."""

Picture = NDArray[np.uint8]


def write_page(
    results: Sequence[PointResult],
    path: Path,
    anchor: str = ANCHOR_LABEL,
    *,
    notes: Sequence[str] = (),
    pictures: bool = True,
    judged: Sequence[Verdict] | None = None,
) -> None:
    """Write the report as one page; pictures that have no room are left out with a note."""
    found = experiments(results)
    judged = verdicts(found) if judged is None else judged
    anchors = [verdict.anchor for verdict in judged]
    anchor = anchor if anchor in anchors else next(iter(anchors), "")
    costs = rate_costs(found, anchor)
    head, rows = rate_cost_cells(costs, anchor)
    page = {
        "preface": preface(results),
        "rates": rates_text(results),
        "psnrs": psnrs_text(results),
        "num_versions": len(code_digests(results)),
        "verdicts": judged,
        "anchor": anchor,
        "share_titles": SHARE_TITLES,
        "tables": {"side_information": side_information_table(found), "cost": cost_table(found)},
        "rate_cost": Table("Rate against cost", RATE_COST_CAPTION, tuple(head), tuple(map(tuple, rows)))
        if len(costs) > 1
        else None,
        "single": [
            f"{one.name}: {curve.label}"
            for one in found
            for curve in one.curves
            if len(curve.points) == 1 and not curve.has_lossless_keys
        ],
        "sizes": sorted({(result.sequence.width, result.sequence.height) for result in results}),
        "styles": {
            label: {
                "colour": style.colour,
                "marker": style.marker,
                "symbol": _SYMBOLS[style.marker] + ("-open" if style.is_open else ""),
                "dash": style.dash,
                "strokes": " ".join(str(2 * length) for length in MATPLOTLIB_DASHES[style.dash][1]),
                "open": style.is_open,
            }
            for label, style in curve_styles(found).items()
        },
        "sequences": [_sequence(one) for one in found],
    }
    data = {
        "styles": page["styles"],
        "sequences": {one.slug: [_chart_curve(curve) for curve in one.curves] for one in found},
        "costs": [[cost.label, cost.cost_ms, cost.bd_rate_percent] for cost in costs],
        "anchor": anchor,
    }
    text = _render(page, data, Gallery(), notes)
    if pictures:
        room = min(MAX_PAGE_BYTES - len(text.encode()) - 50_000, MAX_PICTURE_BYTES)
        gallery = build_gallery(found, max(room, 0))
        if gallery.sources or gallery.num_missing or gallery.num_left_out:
            notes = list(notes)
            if gallery.num_left_out > 0:
                notes.append(
                    f"Pictures of {gallery.num_points} points are shown (at most {MAX_POINTS}: the middle "
                    f"and the ends of each curve); those of {gallery.num_left_out} more are in the results."
                )
            if gallery.num_missing:
                notes.append(f"The pictures of {gallery.num_missing} points are missing or damaged.")
            text = _render(page, data, gallery, notes)
    write_text(path, text)


@dataclass
class Gallery:
    """Pictures of a report."""

    sources: list[str] = field(default_factory=list)  # data URIs, each once
    # Entries by slug of the experiment: curve, point and frame, and indices of the pictures in `sources`.
    shown: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    num_left_out: int = 0  # points without room for their pictures
    num_missing: int = 0  # points with damaged or missing pictures

    @property
    def num_points(self) -> int:
        """Number of points with pictures."""
        return sum(len(entries) for entries in self.shown.values())


def _render(page: dict[str, Any], data: dict[str, Any], gallery: Gallery, notes: Sequence[str]) -> str:
    from plotly.offline import get_plotlyjs

    return render_page(
        TEMPLATES,
        "rd_page.html.j2",
        css=[asset(SHARED, "base.css"), asset(TEMPLATES, "rd_page.css")],
        scripts=[get_plotlyjs(), asset(TEMPLATES, "rd_page.js")],
        **page,
        notes=notes,
        gallery=gallery,
        noise_gain=NOISE_GAIN,
        data=script_json(data | {"pictures": gallery.shown, "sources": gallery.sources}),
    )


def _sequence(one: Experiment) -> dict[str, Any]:
    curves = []
    for curve in one.curves:
        head, rows = points_cells(curve)
        shares, reproduce = [], []
        for point in curve.points:
            parts, code = point.bit_shares, point.code
            text = ", ".join(f"{SHARE_TITLES.get(kind, kind)} {share:.1f} %" for kind, share in parts.items())
            shares.append({"name": point.label, "text": text, "parts": list(parts.items())})
            version = f"dvc3d {code.version} ({code.commit or 'no commit'}, {code.digest})"
            libraries = [f"{name} {number}" for name, number in sorted(point.libraries.items())]
            versions = ", ".join([version if code.digest else code.version, *libraries])
            origin = {"commands": point.commands, "versions": versions, "date": point.date}
            reproduce.append({"name": point.label, **origin})
        table = {"label": curve.label, "lossless": curve.has_lossless_keys, "head": head, "rows": rows}
        curves.append({**table, "shares": shares, "reproduce": reproduce})
    has_frames = any(
        frame.psnr_y_db is not None for c in one.curves for p in c.points for frame in p.per_frame
    )
    names = {"slug": one.slug, "name": one.name, "title": one.title}
    return {**names, "curves": curves, "has_frames": has_frames}


def _chart_curve(curve: Curve) -> dict[str, Any]:
    points = [
        {
            "name": point.label,
            "level": point.level if point.has_level else None,
            "lossless": point.key.lossless,
            "rate": round(point.rate_kbps, 3),
            "psnr": round(point.psnr_y_db, 3),
            "colour": None if point.totals.psnr_yuv_db is None else round(point.totals.psnr_yuv_db, 3),
            "frames": frame_columns(point),
        }
        for point in curve.points
    ]
    lossless = curve.has_lossless_keys
    return {"label": curve.label, "anchor": curve.is_anchor, "lossless": lossless, "points": points}


def frame_columns(point: PointResult) -> dict[str, Any]:
    """Return the columns of the charts of frames: those that have a value, first frame and types."""
    frames = point.per_frame
    columns: dict[str, Any] = {}
    for name, (field_name, decimals) in _FRAME_COLUMNS.items():
        values = [getattr(frame, field_name) for frame in frames]
        if any(value is not None for value in values):
            columns[name] = [None if value is None else round(value, decimals) for value in values]
    bits = [sum(frame.bits.values()) if isinstance(frame.bits, dict) else frame.bits for frame in frames]
    if any(count is not None for count in bits):
        columns["kbits"] = [None if count is None else count / 1000 for count in bits]
    columns["first"] = point.options.start + ((frames[0].index or 0) if frames else 0)
    columns["types"] = "".join(_LETTERS.get(frame.type, "?") for frame in frames)
    return columns


def side_information_table(found: Sequence[Experiment]) -> Table | None:
    """Return the mean PSNR of the side information by sequence and codec."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for one in found:
        points = [(curve.label, point) for curve in one.curves for point in curve.points]
        points = [pair for pair in points if pair[1].totals.si_psnr_y_db is not None]
        lossless = [pair for pair in points if pair[1].key.lossless]
        for label, point in lossless or points:
            keys = "lossless" if lossless else point.level
            refined = point.totals.refined_si_psnr_y_db
            text = number_text(point.totals.si_psnr_y_db, 2) + (
                "" if refined is None else f" ({refined:.2f})"
            )
            cells.setdefault((one.name, keys), {}).setdefault(label, text)
    if not cells:
        return None
    labels = sorted({label for row in cells.values() for label in row})
    rows = [(*names, *(row.get(label, NOTHING) for label in labels)) for names, row in sorted(cells.items())]
    caption = (
        "Mean luma PSNR of the side information of Wyner-Ziv frames in dB, before decoding and, in brackets, "
        "after refinement"
    )
    return Table("Side information", caption, ("sequence", "key frames", *labels), tuple(rows), 2)


def cost_table(found: Sequence[Experiment]) -> Table:
    """Return the processor times of encoding and decoding."""
    rows = []
    for one in found:
        anchor = one.anchor(ANCHOR_LABEL)
        intra = None if anchor is None else mean(point.cpu_ms("coding") for point in anchor.points)
        for curve in one.curves:
            points = curve.points
            encode = mean(point.cpu_ms("coding") for point in points)
            numbers = [
                number_text(mean(point.cpu_ms("key_encode") for point in points), 2),
                number_text(mean(point.cpu_ms("wz_encode") for point in points), 2),
                number_text(encode, 2),
                number_text(None if encode is None or not intra else encode / intra, 2),
                number_text(mean(point.cpu_ms("encode") for point in points), 1),
                number_text(mean(point.cpu_ms("decode") for point in points), 1),
            ]
            rows.append((one.name, curve.label, *numbers))
    times = ("key frame [ms]", "WZ frame [ms]", "any frame [ms]", f"any frame / {ANCHOR_LABEL}")
    head = ("sequence", "codec", *times, "encoder process [ms]", "decoder process [ms]")
    caption = (
        "CPU time per frame: encoding by type of frame, if it was measured; of any frame, tracking "
        "of points included, and its ratio to that of the intra anchor; whole processes, start-up included; "
        "means over the points of a curve"
    )
    return Table("Cost", caption, head, tuple(rows), 2)


def build_gallery(found: Sequence[Experiment], max_bytes: int) -> Gallery:
    """Encode the pictures of the most important points of every curve."""
    candidates = list(_by_importance(found))[:MAX_POINTS]
    for quality in range(WEBP_QUALITY, MIN_WEBP_QUALITY - 1, -10):
        gallery = _encoded(candidates, quality)
        if sum(map(len, gallery.sources)) <= max_bytes:
            break
    while candidates and sum(map(len, gallery.sources)) > max_bytes:
        candidates = candidates[: len(candidates) * 2 // 3]
        gallery = _encoded(candidates, MIN_WEBP_QUALITY)
    points = [point for one in found for curve in one.curves for point in curve.points]
    gallery.num_left_out = sum(map(_has_pictures, points)) - len(candidates)
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
                chosen = list(dict.fromkeys((numbers[len(numbers) // 2], numbers[0], numbers[-1])))
                if rank < len(chosen):
                    yield one, curve, chosen[rank]


def _has_pictures(point: PointResult) -> bool:
    return point.pictures is not None and None not in (point.pictures.original, point.pictures.decoded)


def _encoded(candidates: Sequence[tuple[Experiment, Curve, int]], quality: int) -> Gallery:
    import cv2

    gallery = Gallery()
    indices: dict[bytes, int] = {}
    for one, curve, number in candidates:
        point = curve.points[number]
        files = point.pictures
        original, decoded, predicted = (
            read_picture(Path(name)) if name else None
            for name in ((files.original, files.decoded, files.predicted) if files else (None,) * 3)
        )
        if files is None or original is None or decoded is None or original.shape != decoded.shape:
            gallery.num_missing += 1
            continue
        types = {frame.index: frame.type for frame in point.per_frame}
        entry: dict[str, Any] = {"curve": one.curves.index(curve), "label": curve.label, "point": number}
        entry |= {"index": files.index or 0, "type": _TYPE_NAMES.get(types.get(files.index, ""), "")}
        entry |= {"width": original.shape[1], "height": original.shape[0]}
        planes = {"original": original, "decoded": decoded}
        if predicted is not None and predicted.shape == original.shape:
            difference = NOISE_GAIN * (original.astype(np.int32) - predicted) + 128
            planes["noise"] = np.asarray(np.clip(difference, 0, 255), dtype=np.uint8)
        for kind, plane in planes.items():
            key = plane.tobytes()
            if key not in indices:  # equal pictures are added once
                _, coded = cv2.imencode(".webp", plane, [cv2.IMWRITE_WEBP_QUALITY, quality])
                indices[key] = len(gallery.sources)
                gallery.sources.append(data_uri("image/webp", coded.tobytes()))
            entry[kind] = indices[key]
        entry.setdefault("noise", None)
        gallery.shown.setdefault(one.slug, []).append(entry)
    return gallery


def read_picture(path: Path) -> Picture | None:
    """Read a picture of a point; return None if it is missing, damaged or too large."""
    import cv2

    try:
        with path.open("rb") as file:
            head = file.read(24)
            width, height = (int.from_bytes(head[i : i + 4], "big") for i in (16, 20))
            if not head.startswith(b"\x89PNG") or not 0 < max(width, height) <= MAX_PICTURE_SIDE_PX:
                return None
            coded = head + file.read(MAX_FILE_BYTES)
        plane: Any = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_GRAYSCALE)
    except (OSError, cv2.error):
        return None
    return None if plane is None else np.asarray(plane, dtype=np.uint8)
