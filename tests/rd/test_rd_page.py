"""The page without a browser: contents, escaping, and size."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from dvc.errors import DvcError
from dvc.rd import __main__ as command
from dvc.rd.comparison import verdicts
from dvc.rd.rd_curves import experiments
from dvc.rd.rd_page import (
    MAX_PAGE_BYTES,
    build_gallery,
    cost_table,
    frame_columns,
    read_picture,
    side_information_table,
    write_page,
)
from dvc.rd.rd_results import (
    POINTS_FOLDER,
    PictureFiles,
    PointResult,
    parse_result,
    read_folders,
    read_results,
)
from tests.rd.made_up import result_data, write_colour_results, write_results
from tests.rd.made_up_page import HOSTILE, write_many


def page_of(results: list[PointResult], path: Path, **options: object) -> str:
    write_page(results, path, **options)  # type: ignore[arg-type]
    return path.read_text(encoding="utf-8")


def own_text(page: str) -> str:
    """Return the page without the library for charts."""
    return page.replace(get_plotlyjs(), "")


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_many(tmp_path_factory.mktemp("page") / "results", levels=3)


def test_page_holds_everything_and_names_stay_text(many: Path, tmp_path: Path) -> None:
    """No text of a result becomes an element, no address leads outside, and the size is bounded."""
    page = page_of(read_folders([many])[0], tmp_path / "page.html")
    text = own_text(page)
    assert HOSTILE not in text
    assert "&lt;script&gt;window.stolen=1" in text
    assert "</script><b>" not in text
    assert not re.search(r'(?:src|href)="(?!data:|#)', re.sub(r"<script.*?</script>", "", text))
    assert "default-src &#39;none&#39;" in text
    assert len(page.encode()) < MAX_PAGE_BYTES


def test_every_curve_can_be_the_anchor(many: Path) -> None:
    """All pairs are compared; the means are over all sequences; a swap of roles swaps the sign."""
    judged = {verdict.anchor: verdict for verdict in verdicts(experiments(read_folders([many])[0]))}
    assert len(judged) == 5
    assert all(len(verdict.rows) == 12 for verdict in judged.values())
    intra = judged["H.264 intra"]
    assert intra.matrix[-1][0] == "mean (sequences)"
    assert all(cell.text.endswith(" (3)") for cell in intra.matrix[-1][1])
    assert {cell.outcome for _, cells in intra.matrix for cell in cells} == {"better"}
    other = judged["2D-DVC, GOP 2"]
    assert {row.outcome for row in other.rows if row.codec == "H.264 intra"} == {"worse"}
    assert "dB (" in intra.rows[0].overlap
    assert intra.rows[0].points == "3 and 3"


def test_curves_that_cannot_be_compared_say_why(tmp_path: Path) -> None:
    """A curve of one point has no BD figure and no mean, and a note names it."""
    results = [
        parse_result("a", result_data(60.0, 30.0)),
        parse_result("b", result_data(70.0, 30.0, codec="h264-intra")),
    ]
    page = own_text(page_of(results, tmp_path / "page.html"))
    assert "not comparable: curve A: 1 useful points" in page
    assert "Curves of one point are shown as points, without BD figures: clip: 2D-DVC, GOP 2" in page
    assert "mean (sequences)" not in page.split("<script", maxsplit=1)[0]
    single = own_text(page_of(results[:1], tmp_path / "page.html"))
    assert "No two curves on the same frames" in single


def test_frames_and_shares() -> None:
    row = {"index": 0, "type": "wz", "bits": {"parity": 1500, "crc": 500}, "si_psnr_y_db": 30.0}
    point = parse_result("a", result_data(60.0, 30.0, per_frame=[{"type": "key", "bits": 4000}, row]))
    columns = frame_columns(point)
    assert columns == {"kbits": [4.0, 2.0], "initial": [None, 30.0], "first": 0, "types": "kw"}
    assert point.bit_shares == {"key": 75.0, "parity": 20.0, "crc": 1.0, "header": 4.0}


def test_side_information_prefers_lossless_keys() -> None:
    lossy = result_data(60.0, 30.0)
    lossless = result_data(600.0, 40.0, key={"qp": 0, "lossless": True})
    lossless["totals"] |= {"si_psnr_y_db": 33.0}
    found = experiments([parse_result("a", lossy), parse_result("b", lossless)])
    table = side_information_table(found)
    assert table is not None
    assert table.rows == (("clip", "lossless", "33.00"),)
    assert side_information_table(experiments([parse_result("a", lossy)])) is not None


def test_experiments_of_one_name_get_distinct_names(tmp_path: Path) -> None:
    longer = result_data(60.0, 30.0)
    longer["totals"] |= {"frames": 5}
    results = [parse_result("a", result_data(60.0, 30.0)), parse_result("b", longer)]
    page = own_text(page_of(results, tmp_path / "page.html"))
    assert ">clip (frames 0 to 2)</h2>" in page
    assert ">clip (frames 0 to 4)</h2>" in page


def test_lossless_key_frames_have_no_part_in_the_verdict() -> None:
    lossless = [
        parse_result(str(i), result_data(600.0 + i, 40.0 + i, key={"qp": 0, "lossless": True}))
        for i in (0, 1)
    ]
    lossy = [parse_result(f"a{i}", result_data(60.0 + i, 30.0 + i, codec="h264-intra")) for i in (0, 1)]
    assert verdicts(experiments([*lossless, *lossy])) == []


def test_cost_is_per_frame_and_relative_to_intra(tmp_path: Path) -> None:
    """Encoding times are divided by the frames of their type, and by that of the intra anchor."""
    codec, intra = cost_table(experiments(read_folders([write_results(tmp_path / "a")])[0])).rows
    assert codec[2:6] == ("1.00", "1.00", "1.00", "1.00")
    assert intra[1] == "H.264 intra"
    assert intra[3] == "–"
    data = result_data(60.0, 30.0)  # the time of any frame is not that of a few of its parts
    del data["times"]["wz_encode_cpu_s"], data["times"]["coding_cpu_s"]
    (row,) = cost_table(experiments([parse_result("a", data)])).rows
    assert row[2:6] == ("1.00", "–", "–", "–")


def test_page_shows_rate_against_cost(tmp_path: Path) -> None:
    results = read_results(write_results(tmp_path / "a"))
    page = page_of(results, tmp_path / "both.html")
    assert "Rate against cost of encoding" in own_text(page)
    assert page_of(results, tmp_path / "again.html") == page
    with pytest.raises(DvcError, match="does not exist"):
        write_page(results, tmp_path / "none" / "page.html")
    one = [result for result in results if result.codec == "2d"]
    assert "Rate against cost of encoding" not in own_text(page_of(one, tmp_path / "one.html"))


def test_damaged_and_repeated_results_are_named(tmp_path: Path) -> None:
    first, second = write_results(tmp_path / "a"), write_results(tmp_path / "b", scale=1.1)
    (first / POINTS_FOLDER / "broken.json").write_text("{", encoding="utf-8")
    for path in (second / POINTS_FOLDER).glob("*.json"):
        data = json.loads(path.read_text(encoding="utf-8")) | {"date": "2026-02-01", "identity": "1" * 32}
        path.write_text(json.dumps(data), encoding="utf-8")
    results, notes = read_folders([first, second])
    assert any("1 damaged file left out: broken.json." in note for note in notes)
    assert any("newer one" in note for note in notes)
    assert {result.date for result in results} == {"2026-02-01"}


def test_pictures_outside_the_folder_are_not_read(tmp_path: Path) -> None:
    folder = write_results(tmp_path / "a")
    outside = tmp_path / "secret.png"
    cv2.imwrite(str(outside), np.zeros((8, 8), np.uint8))
    path = next((folder / POINTS_FOLDER).glob("codec-*.json"))
    data = json.loads(path.read_text(encoding="utf-8"))
    names = {"original": "../secret.png", "decoded": str(outside), "predicted": None, "key": "/etc/passwd"}
    data["pictures"] = {"index": 1, **names}
    path.write_text(json.dumps(data), encoding="utf-8")
    results = read_folders([folder])[0]
    assert [result.pictures for result in results if result.pictures] == [PictureFiles(index=1)]
    assert build_gallery(experiments(results), 10**6).sources == []


def test_pictures_keep_to_their_room(many: Path) -> None:
    results = read_folders([many])[0]
    found = experiments(results)
    full, tight = build_gallery(found, 10**7), build_gallery(found, 20_000)
    assert full.num_points == 40
    assert full.num_left_out == 5
    assert 0 < tight.num_points < 40
    assert sum(map(len, tight.sources)) <= 20_000
    assert len(full.sources) < 3 * full.num_points
    assert results[0].pictures is not None
    broken = replace(results[0], pictures=replace(results[0].pictures, decoded=str(many / "gone.png")))
    assert build_gallery(experiments([broken]), 10**6).num_missing == 1


def test_command_writes_both_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_results(tmp_path / "a")
    assert command.main(["report", str(folder), "--against", "2D"]) == 0
    names = [Path(line).name for line in capsys.readouterr().out.split()]
    assert names == ["report.html", "report.md", "report-clip.png", "report-clip.svg"]
    page, figures = tmp_path / "page.html", tmp_path / "plots"
    assert command.main(["report", str(folder), "--out", str(page), "--figures", str(figures)]) == 0
    assert sorted(path.name for path in figures.iterdir()) == ["page-clip.png", "page-clip.svg"]
    assert command.main(["report", str(folder), "--out", str(tmp_path / "page.pdf")]) == 2
    assert command.main(["report", str(folder), "--against", "nobody"]) == 2


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x89PNG",
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (2**20).to_bytes(4, "big") * 2,
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (8).to_bytes(4, "big") * 2 + b"nothing more",
        b"GIF89a" + bytes(99),
    ],
)
def test_files_that_are_no_pictures_of_points(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "p.png").write_bytes(data)
    assert read_picture(tmp_path / "p.png") is None
    assert read_picture(tmp_path / "none.png") is None


def test_page_shows_luma_and_colour(tmp_path: Path) -> None:
    results = read_results(write_colour_results(tmp_path / "a"))
    judged = {verdict.anchor: verdict for verdict in verdicts(experiments(results))}
    intra = judged["H.264 intra"]
    assert intra.columns == ["2D-DVC, GOP 2: luma", "2D-DVC, GOP 2: colour"]
    ((_, cells),) = intra.matrix
    assert [cell.outcome for cell in cells] == ["better", "none"]
    assert [text.lstrip("+") for text in intra.rows[0].differences][:2] in (
        ["−20.0 %", "0.0 %"],
        ["−20.0 %", "−0.0 %"],
    )
    page = own_text(page_of(results, tmp_path / "page.html"))
    assert "2D-DVC, GOP 2: colour</th>" in page
    assert "BD-rate, colour</th>" in page
    assert '"colour":31.5' in page.replace(" ", "")
    plain = own_text(page_of(read_results(write_results(tmp_path / "b")), tmp_path / "page.html"))
    assert "BD-rate, colour" not in plain
