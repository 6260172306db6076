"""A page of pictures in groups, side by side or two over each other, with tables of figures."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvc.web.document import SHARED, asset, data_uri, render_page, write_text

PAGE = "index.html"
"""Usual name of a gallery in its folder."""
MAX_SIDE_PX = 1600
"""Longest side of a picture; larger pictures are reduced."""
QUALITY = 88


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture of the page."""

    name: str  # unique in its group
    picture: NDArray[np.uint8]  # grey levels, or blue, green and red, and opacity
    text: str = ""  # rest of its caption


@dataclass(frozen=True, eq=False)
class Group:
    """Pictures of one subject, which may be laid over each other."""

    name: str
    pictures: tuple[Shown, ...]  # at least one, of one size or shape


@dataclass(frozen=True)
class Table:
    """A table of figures."""

    title: str
    caption: str  # without a full stop
    head: tuple[str, ...]  # titles of the columns
    rows: tuple[tuple[str, ...], ...]  # cells
    num_names: int = 1  # number of columns on the left that hold names


@dataclass(frozen=True, eq=False)
class Gallery:
    """Contents of a page."""

    title: str
    preface: str
    groups: Sequence[Group]  # at least one
    tables: Sequence[Table] = field(default=())
    notes: Sequence[str] = field(default=())  # caveats


def markdown(table: Table) -> str:
    """Return a table in Markdown."""
    rule = ["---"] * table.num_names + ["---:"] * (len(table.head) - table.num_names)
    lines = [table.head, rule, *table.rows]
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return f"## {table.title}\n\n{table.caption}.\n\n{body}\n"


def write_gallery(path: Path, gallery: Gallery) -> None:
    """Write the page as one self-contained file."""
    groups = [
        {
            "name": group.name,
            "number": number,
            "several": len(group.pictures) > 1,
            "pictures": [_embedded(shown) for shown in group.pictures],
        }
        for number, group in enumerate(gallery.groups)
    ]
    page = render_page(
        SHARED,
        "gallery.html.j2",
        css=[asset(SHARED, "base.css")],
        scripts=[asset(SHARED, "gallery.js")],
        title=gallery.title,
        preface=gallery.preface,
        notes=gallery.notes,
        tables=gallery.tables,
        groups=groups,
    )
    write_text(path, page)


def _embedded(shown: Shown) -> dict[str, object]:
    import cv2

    picture = shown.picture
    largest = max(picture.shape[:2])
    if largest > MAX_SIDE_PX:
        scale = MAX_SIDE_PX / largest
        resized = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        picture = np.asarray(resized, np.uint8)
    if picture.shape[2:] == (4,):
        _, coded = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
        kind = "webp"
    else:  # somewhat larger, but many times faster
        _, coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        kind = "jpeg"
    height, width = picture.shape[:2]
    source = data_uri(f"image/{kind}", coded.tobytes())
    return {"name": shown.name, "text": shown.text, "source": source, "width": width, "height": height}
