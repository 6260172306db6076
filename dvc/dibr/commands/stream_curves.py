"""Curves of given streams: quality by rate, a line for each kind."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvc import cli
from dvc.web.gallery import Gallery, Group, Shown, Table, markdown, write_gallery
from dvc.web.plotting import Line, line_plot

DOCUMENT, VALUES, PAGE = "streams.md", "streams.json", "index.html"
_QUALITIES = {"psnr_image_db": "Picture", "psnr_depth_db": "Depth map"}


def lines_of(label: Mapping[str, dict[str, Any]], quality: str) -> list[Line]:
    """Return the points of streams by kind, in the order of their rates."""
    points: dict[str, list[tuple[float, float]]] = {}
    for one in label.values():
        if one.get(quality) is not None:
            points.setdefault(one["kind"], []).append((one["bpp"], one[quality]))
    return [Line(kind, *zip(*sorted(found), strict=True)) for kind, found in points.items()]


def write_page(folder: Path, label: Mapping[str, dict[str, Any]], table: Table) -> None:
    """Write curves and table."""
    drawn, groups = [], []
    for quality, title in _QUALITIES.items():
        lines = lines_of(label, quality)
        if not lines:
            continue
        name = title.lower().replace(" ", "-")
        files = line_plot(lines, title, "bits per pixel", "PSNR [dB]")
        for suffix, content in files.items():
            (folder / f"{name}{suffix}").write_bytes(content)
        drawn.append(f"![{title}]({name}.png)\n")
        picture = cv2.imdecode(np.frombuffer(files[".png"], np.uint8), cv2.IMREAD_COLOR)
        groups.append(Group(title, (Shown(title, np.asarray(picture, np.uint8)),)))
    text = "\n".join(["# Streams\n", markdown(table), *drawn])
    (folder / DOCUMENT).write_text(text, encoding="utf-8", errors="replace")
    cli.write_json(folder / VALUES, dict(label))
    if groups:
        write_gallery(folder / PAGE, Gallery("Streams", "Quality by rate.", groups, [table]))
