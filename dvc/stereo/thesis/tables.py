"""Tables 2.1, 2.2 and 2.3: what the thesis prints beside what was measured."""

from collections.abc import Mapping, Sequence

from dvc.page.gallery import Table

SETS = ("tsukuba", "venus", "teddy", "cones")
CAMERAS = (2, 5, 25)
OURS, OURS_RAW, BASELINE = "this program", "this program, squared difference", "StereoSGBM, holes filled"
THESIS_2_1 = {
    "thesis: proposed method": (1.53, 1.04, 10.9, 8.65),
    "thesis: best method of each": (1.29, 0.21, 6.54, 7.86),
}
"""Bad pixels in per cent, over all areas."""
THESIS_2_2 = {
    2: (("proposed", 1.5), ("New Kolmogorov, Zabih 2005", 2.2), ("Wei, Quan 2005", 2.7)),
    5: (
        ("proposed", 1.3),
        ("New Kolmogorov, Zabih 2005", 1.3),
        ("Wei, Quan 2005", 1.3),
        ("Drouin et al. 2005", 2.2),
        ("Kolmogorov, Zabih 2002", 2.3),
    ),
    25: (("proposed", 1.3),),
}
THESIS_2_3 = {1: (106, 0.0), 2: (108, 2.1), 5: (116, 9.7), 25: (127, 19.4)}
"""Thousands of values, and by how many per cent they are more than in one disparity map."""
Percent = Mapping[str, float]
"""Bad pixels by mask: nonocc, all, disc."""


def table_2_1(measured: Mapping[str, Mapping[str, Percent]]) -> Table:
    """Make table 2.1."""
    head = ("bad pixels, all [%]", *SETS, "mean")
    rows = [(name, *_cells(values)) for name, values in THESIS_2_1.items()]
    for method, by_set in measured.items():
        rows.append((method, *_cells([by_set[name]["all"] for name in SETS])))
    for mask, told in (("nonocc", "not occluded"), ("disc", "near discontinuities")):
        for method, by_set in measured.items():
            rows.append((f"{method}: {told}", *_cells([by_set[name][mask] for name in SETS])))
    caption = "Two cameras: pixels more than 1 px off, in per cent"
    return Table("Table 2.1", caption, head, tuple(rows))


def table_2_2(measured: Mapping[int, Percent]) -> Table:
    """Make table 2.2."""
    rows = []
    for cameras, percent in measured.items():
        rows.append((f"{cameras} cameras: {OURS}", f"{percent['all']:.2f}"))
        rows += [
            (f"{cameras} cameras, thesis: {name}", f"{value:.1f}") for name, value in THESIS_2_2[cameras]
        ]
    head = ("Tsukuba", "bad pixels, all [%]")
    return Table("Table 2.2", "Several cameras: pixels more than 1 px off", head, tuple(rows))


def table_2_3(num_pixels: int, measured: Mapping[int, tuple[int, int, int]]) -> Table:
    """Make table 2.3."""
    rows = [("disparity map", str(num_pixels), "0.0 %", "1", "–", *_thesis_2_3(1))]
    for cameras, (inside, beyond, layers) in measured.items():
        more = f"+{100.0 * (inside / num_pixels - 1.0):.1f} %"
        row = f"layered image, {cameras} cameras", str(inside), more, str(layers), str(beyond)
        rows.append((*row, *_thesis_2_3(cameras)))
    head = ("Tsukuba", "values", "more", "layers", "beyond the frame", "thesis: values", "thesis: more")
    return Table("Table 2.3", "Values of layered depth images inside the reference frame", head, tuple(rows))


def markdown(table: Table) -> str:
    """Write a table for documents."""
    rule = ["---"] * table.num_names + ["---:"] * (len(table.head) - table.num_names)
    lines = [table.head, rule, *table.rows]
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return f"## {table.title}\n\n{table.caption}.\n\n{body}\n"


def _cells(values: Sequence[float]) -> list[str]:
    return [f"{value:.2f}" for value in (*values, sum(values) / len(values))]


def _thesis_2_3(cameras: int) -> tuple[str, str]:
    thousands, percent = THESIS_2_3[cameras]
    return f"{thousands} 000", f"+{percent:.1f} %"
