"""The page put together: what the template shows, and the file that holds all of it."""

from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc.files import atomic_output
from dvc.rd.curves import ANCHOR_LABEL, Curve, Experiment, experiments
from dvc.rd.page.pictures import MAX_POINTS, NOISE_GAIN, Gallery, build_gallery
from dvc.rd.page.tables import (
    SHARE_TITLES,
    chart_points,
    cost_table,
    rate_cost_table,
    shares,
    side_information_table,
)
from dvc.rd.page.verdict import Verdict, verdicts
from dvc.rd.plots import (
    Style,
    curve_styles,
    render_experiment,
    render_frames,
)
from dvc.rd.point_result import PointResult
from dvc.rd.rate_cost import rate_costs, render_rate_cost
from dvc.rd.tables import code_digests, points_cells, preface, psnrs_text, rates_text
from dvc.web.document import SHARED, asset, content_policy, data_uri, script_json, template
from dvc.web.plotting import MATPLOTLIB_DASHES

if TYPE_CHECKING:
    from jinja2 import Template

MAX_PAGE_BYTES = 8_000_000
MAX_PICTURE_BYTES = 6_000_000
TEMPLATES = resources.files("dvc.rd.page") / "templates"
SYMBOLS = {"o": "circle", "s": "square", "^": "triangle-up", "D": "diamond", "v": "triangle-down"}
SYMBOLS |= {"P": "cross", "x": "x-thin"}
"""Markers of Plotly by those of matplotlib."""


def write_page(
    results: Sequence[PointResult],
    path: Path,
    anchor: str = ANCHOR_LABEL,
    *,
    notes: Sequence[str] = (),
    pictures: bool = True,
    drawn: dict[str, dict[str, bytes]] | None = None,
    judged: Sequence[Verdict] | None = None,
) -> None:
    """Write the report as one HTML file, which needs no other file and no network."""
    found = experiments(results)
    styles = curve_styles(found)
    drawn = drawn or {one.slug: render_experiment(one, styles, (".svg",), anchor) for one in found}
    texts = _texts(results, found, anchor, verdicts(found) if judged is None else judged)
    page = {
        **texts,
        "rate_cost": _rate_cost(found, styles, texts["anchor"]),
        "styles": {label: _style(style) for label, style in styles.items()},
        "sequences": [_sequence(one, drawn[one.slug][".svg"], styles) for one in found],
    }
    data = {
        "styles": page["styles"],
        "sequences": {one.slug: [_chart_curve(curve) for curve in one.curves] for one in found},
    }
    text = _render(page, data, Gallery(), notes)
    if pictures:
        room = min(MAX_PAGE_BYTES - len(text.encode()) - 50_000, MAX_PICTURE_BYTES)
        gallery = build_gallery(found, max(room, 0))
        if gallery.sources or gallery.num_missing or gallery.num_left_out:
            text = _render(page, data, gallery, [*notes, *_picture_notes(gallery)])
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _render(page: dict[str, Any], data: dict[str, Any], gallery: Gallery, notes: Sequence[str]) -> str:
    from plotly.offline import get_plotlyjs

    scripts = {
        "early": asset(SHARED, "early.js"),
        "library": get_plotlyjs(),
        "script": asset(TEMPLATES, "page.js"),
    }
    data = data | {"pictures": gallery.shown, "sources": gallery.sources}
    return _template().render(
        **page,
        **scripts,
        notes=notes,
        gallery=gallery,
        noise_gain=NOISE_GAIN,
        css=asset(SHARED, "base.css") + asset(TEMPLATES, "page.css"),
        data=script_json(data),
        policy=content_policy(scripts.values()),
    )


def _texts(
    results: Sequence[PointResult], found: Sequence[Experiment], anchor: str, judged: Sequence[Verdict]
) -> dict[str, Any]:
    names = [verdict.anchor for verdict in judged]
    return {
        "preface": preface(results),
        "rates": rates_text(results),
        "psnrs": psnrs_text(results),
        "num_versions": len(code_digests(results)),
        "verdicts": judged,
        "anchor": anchor if anchor in names else names[0] if names else "",
        "share_titles": SHARE_TITLES,
        "tables": {"side_information": side_information_table(found), "cost": cost_table(found)},
        "single": [
            f"{one.name}: {curve.label}"
            for one in found
            for curve in one.curves
            if len(curve.points) == 1 and not curve.has_lossless_keys
        ],
        "sizes": sorted({(r.data["sequence"]["width"], r.data["sequence"]["height"]) for r in results}),
    }


def _rate_cost(found: Sequence[Experiment], styles: dict[str, Style], anchor: str) -> dict[str, Any] | None:
    """Return rate against cost as a table and a picture, where there are two codecs."""
    costs = rate_costs(found, anchor)
    if len(costs) < 2:
        return None
    picture = render_rate_cost(costs, styles, anchor, (".svg",))[".svg"]
    return {"table": rate_cost_table(costs, anchor), "picture": data_uri("image/svg+xml", picture)}


def _sequence(one: Experiment, svg: bytes, styles: dict[str, Style]) -> dict[str, Any]:
    curves = []
    for curve in one.curves:
        head, rows = points_cells(curve)
        curves.append(
            {
                "label": curve.label,
                "lossless": curve.has_lossless_keys,
                "head": head,
                "rows": rows,
                "shares": shares(curve),
                "reproduce": [_reproduce(point) for point in curve.points],
            }
        )
    codecs = [curve for curve in one.curves if any("initial" in p["frames"] for p in chart_points(curve))]
    chosen = (codecs or list(one.curves))[0]
    frames = render_frames(chosen, chosen.points[len(chosen.points) // 2], styles[chosen.label])
    return {
        "slug": one.slug,
        "name": one.name,
        "title": one.title,
        "curves": curves,
        "picture": data_uri("image/svg+xml", svg),
        "frames_picture": None if frames is None else data_uri("image/svg+xml", frames),
    }


def _chart_curve(curve: Curve) -> dict[str, Any]:
    return {
        "label": curve.label,
        "anchor": curve.is_anchor,
        "lossless": curve.has_lossless_keys,
        "points": chart_points(curve),
    }


def _reproduce(point: PointResult) -> dict[str, Any]:
    data = point.data
    code, libraries = data["code"], data.get("libraries")
    own = f"dvc3d {code['version']} ({code.get('commit') or 'no commit'}, {code['digest']})"
    versions = [own if code["digest"] else code["version"]]
    if isinstance(libraries, dict):
        versions += [f"{name} {version}" for name, version in sorted(libraries.items())]
    commands = data.get("commands")
    return {
        "name": point.label,
        "commands": [str(line) for line in commands] if isinstance(commands, list) else [],
        "versions": ", ".join(versions),
        "date": str(data.get("date", "")),
    }


def _style(style: Style) -> dict[str, Any]:
    line = MATPLOTLIB_DASHES[style.dash][1]
    return {
        "colour": style.colour,
        "marker": style.marker,
        "symbol": SYMBOLS[style.marker] + ("-open" if style.is_open else ""),
        "dash": style.dash,
        "strokes": " ".join(str(2 * length) for length in line),
        "open": style.is_open,
    }


def _picture_notes(gallery: Gallery) -> list[str]:
    notes = []
    if gallery.num_left_out > 0:
        notes.append(
            f"Pictures are shown of {gallery.num_points} points (at most {MAX_POINTS}: the middle and "
            f"the ends of each curve); those of {gallery.num_left_out} more are in the results."
        )
    if gallery.num_missing:
        notes.append(f"The pictures of {gallery.num_missing} points are missing or damaged.")
    return notes


@cache
def _template() -> "Template":
    return template(TEMPLATES, "page.html.j2")
