"""Code a moving camera between two processes, by file and live, and show rates and pictures: `make demo`."""

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pictures.drawing import decoding_stages
from benchmarks.results.harness import report_of, run_module
from benchmarks.results.live import serving
from dvc.picture_files import write_png

QPS, PROVEN_QP, SHOWN_QP = (36, 30), 36, 30
"""Qualities of the codec; the one that is coded in every way; the one that is drawn."""
ANCHOR_QPS = {"H.264 intra": (40, 36, 32), "x264 medium": (40, 36, 32, 28)}
NUM_FRAMES = 9
SIZE = "176x144"


@dataclass(frozen=True)
class Row:
    """One line of the table: how the video was coded, and the totals of its report."""

    name: str
    report: dict[str, Any]

    @property
    def rate_kbps(self) -> float:
        """Rate that was really needed."""
        return float(self.report["rate_kbps"])

    @property
    def psnr_db(self) -> float:
        """Mean PSNR over all frames: (6 Y + Cb + Cr) / 8, or of luma if the video has no chroma."""
        return float(self.report.get("psnr_yuv_db", self.report["psnr_y_db"]))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demonstration."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for everything")
    parser.add_argument("--video", type=Path, help="code this instead of a rendered street")
    arguments = parser.parse_args(argv)
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    video = arguments.video or _render(folder)
    print("encoding and decoding in processes of their own, over files and live ...", flush=True)
    with ThreadPoolExecutor(2) as pool:
        own = [pool.submit(_code, video, folder, qp) for qp in QPS]
        proven = pool.submit(_prove, video, folder, own[QPS.index(PROVEN_QP)].result)
        anchors = {name: pool.submit(_code_anchor, video, folder, name) for name in ANCHOR_QPS}
        rows = [Row(f"3d-te, QP {qp}", run.result()) for qp, run in zip(QPS, own, strict=True)]
        curves = {name: run.result() for name, run in anchors.items()}
        proven.result()
    _print_table(rows, curves)
    name = f"qp{SHOWN_QP}"
    decoded, predicted = folder / f"{name}.mkv", folder / f"{name}_predicted.mkv"
    stages = decoding_stages(decoded, predicted, report_of(folder / f"{name}.json")["per_frame"])
    write_png(folder / "demo.png", stages)
    print(f"\nfiles are in {folder}; look at {folder / 'demo.png'}")
    return 0


def _render(folder: Path) -> Path:
    print("rendering a camera that moves along a street ...", flush=True)
    video = folder / "street.mkv"
    run_module("sequences", "render", "street", "--size", SIZE, "--frames", NUM_FRAMES, "--out", video)
    return video


def _options(qp: int) -> list[object]:
    return ["--qp", qp, "--quiet"]


def _outputs(folder: Path, name: str) -> list[object]:
    return [folder / f"{name}.mkv", "--punctured", folder / f"{name}_punctured.dvc", "--quiet"]


def _code(video: Path, folder: Path, qp: int) -> dict[str, Any]:
    """Encode in one process, decode in another; return the report."""
    name = f"qp{qp}"
    stream, report = folder / f"{name}.dvc", folder / f"{name}.json"
    run_module("encoder", video, stream, *_options(qp))
    predicted = ["--side-information-video", folder / f"{name}_predicted.mkv"]
    run_module("decoder", stream, *_outputs(folder, name), *predicted, "--reference", video, "--json", report)
    return report_of(report)


def _prove(video: Path, folder: Path, wait: Any) -> None:
    """Decode the punctured stream in a fresh process, and code the same live: all must be the same."""
    wait()
    name = f"qp{PROVEN_QP}"
    run_module("decoder", folder / f"{name}_punctured.dvc", *_outputs(folder, "again"))
    with serving(video, folder, _options(PROVEN_QP)) as address:
        run_module("decoder", "--connect", address, *_outputs(folder, "live"))
    for other in ("again", "live"):
        for end in (".mkv", "_punctured.dvc"):
            if (folder / f"{name}{end}").read_bytes() != (folder / f"{other}{end}").read_bytes():
                raise SystemExit(f"{name}{end} and {other}{end} differ")


def _code_anchor(video: Path, folder: Path, name: str) -> list[Row]:
    """Code the same frames by a standard codec."""
    rows = []
    anchor = {"H.264 intra": "x264-intra", "x264 medium": "x264-medium"}[name]
    for qp in ANCHOR_QPS[name]:
        stream, report = folder / f"{anchor}_qp{qp}.264", folder / f"{anchor}_qp{qp}.json"
        run_module("dvc.rd.anchors", "encode", video, stream, "--codec", anchor, "--qp", qp)
        run_module("dvc.rd.anchors", "decode", stream, "--reference", video, "--json", report)
        rows.append(Row(f"{name}, QP {qp}", report_of(report)["totals"]))
    return rows


def _saving(row: Row, curve: list[Row]) -> str:
    """Compare a rate with that of a curve at equal PSNR, by interpolation; empty beyond its points."""
    quality = np.array([point.psnr_db for point in curve])
    if not quality[0] <= row.psnr_db <= quality[-1]:
        return ""
    rate = np.exp(np.interp(row.psnr_db, quality, np.log([point.rate_kbps for point in curve])))
    return f"{100 * (row.rate_kbps / rate - 1):+.1f} %"


def _print_table(rows: list[Row], curves: dict[str, list[Row]]) -> None:
    lines: list[tuple[str, ...]] = [
        ("", "kbit/s", "luma", "colour", "prediction", *(f"vs {name}" for name in curves), "decoding"),
        ("", "", "dB", "dB", "luma, dB", *["at equal colour dB"] * len(curves), "s per WZ frame"),
    ]
    for row in [*rows, *(row for curve in curves.values() for row in curve)]:
        cells = [row.name, f"{row.rate_kbps:.1f}", f"{row.report['psnr_y_db']:.2f}", f"{row.psnr_db:.2f}"]
        if row in rows:
            num_predicted = sum(frame["type"] == "wz" for frame in row.report["per_frame"])
            cells += [f"{row.report['si_psnr_y_db']:.2f}", *(_saving(row, own) for own in curves.values())]
            cells.append(f"{row.report['decode_s'] / max(num_predicted, 1):.2f}")
        lines.append((*cells, *[""] * (len(lines[0]) - len(cells))))
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    print()
    for line in lines:
        name, *cells = (cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        print("  ".join([name.strip().ljust(widths[0]), *cells]).rstrip())
    print(
        f"\nRates are sizes of files. A fresh process decoded the punctured stream of QP {PROVEN_QP} without"
    )
    print("feedback, and the same was coded again live, over TCP: the same frames, the same bits.")
    print("PSNR in colour is (6 Y + Cb + Cr) / 8.")


if __name__ == "__main__":
    sys.exit(main())
