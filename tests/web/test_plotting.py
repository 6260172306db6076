"""Line plots."""

from dvc.web.plotting import SUFFIXES, Line, line_plot


def test_the_same_lines_give_the_same_bytes() -> None:
    """Both forms are there, names stand in the SVG, and nothing depends on the time."""
    lines = [Line("first", [0.1, 0.2], [30.0, 31.0]), Line("_cost in $ \u540d", [0.1, 0.3], [29.0, 30.5])]
    drawn = line_plot(lines, "title", "rate", "PSNR")
    assert set(drawn) == set(SUFFIXES)
    assert drawn == line_plot(lines, "title", "rate", "PSNR")
    text = drawn[".svg"].decode()
    assert "first" in text
    assert "cost in $" in text
    assert drawn[".png"].startswith(b"\x89PNG")
