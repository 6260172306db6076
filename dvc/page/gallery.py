"""A page of pictures in groups, beside each other and two of them over each other, with figures in tables."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvc.files import atomic_output
from dvc.page.document import SHARED, asset, content_policy, data_uri, template

MAX_SIDE_PX = 1600
"""Larger pictures are shown smaller."""
QUALITY = 88


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture of the page.

    Attributes
    ----------
    name : str
        What it is, unique in its group.
    picture : ndarray of shape (H, W) or (H, W, 3 or 4), uint8
        Grey levels, or blue, green and red, and opacity.
    text : str
        What else its caption says.
    """

    name: str
    picture: NDArray[np.uint8]
    text: str = ""


@dataclass(frozen=True, eq=False)
class Group:
    """Pictures of one thing, which may be laid over each other.

    Attributes
    ----------
    name : str
        Of the thing.
    pictures : tuple of Shown
        At least one, of one size or shape.
    """

    name: str
    pictures: tuple[Shown, ...]


@dataclass(frozen=True)
class Table:
    """Figures.

    Attributes
    ----------
    title : str
        Heading.
    caption : str
        What it shows, without a full stop.
    head : tuple of str
        Titles of the columns.
    rows : tuple of tuple of str
        Cells.
    num_names : int
        Columns on the left that are names and no numbers.
    """

    title: str
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    num_names: int = 1


@dataclass(frozen=True, eq=False)
class Gallery:
    """What a page shows.

    Attributes
    ----------
    title, preface : str
        Heading, and what it is about.
    groups : sequence of Group
        At least one.
    tables : sequence of Table
        Figures.
    notes : sequence of str
        What a reader must know.
    """

    title: str
    preface: str
    groups: Sequence[Group]
    tables: Sequence[Table] = field(default=())
    notes: Sequence[str] = field(default=())


def write_gallery(path: Path, gallery: Gallery) -> None:
    """Write the page as one file, which needs no other file and no network.

    Parameters
    ----------
    path : Path
        The file.
    gallery : Gallery
        What it shows.

    Raises
    ------
    DvcError
        If it cannot be written.
    """
    scripts = {"early": asset(SHARED, "early.js"), "script": asset(SHARED, "gallery.js")}
    groups = [
        {
            "name": group.name,
            "number": number,
            "several": len(group.pictures) > 1,
            "pictures": [_embedded(shown) for shown in group.pictures],
        }
        for number, group in enumerate(gallery.groups)
    ]
    text = template(SHARED, "gallery.html.j2").render(
        title=gallery.title,
        preface=gallery.preface,
        notes=gallery.notes,
        tables=gallery.tables,
        groups=groups,
        css=asset(SHARED, "base.css"),
        policy=content_policy(scripts.values()),
        **scripts,
    )
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


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
