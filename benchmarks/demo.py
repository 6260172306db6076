"""Code a moving camera between two processes, by file and live, and show rates and pictures: `make demo`."""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dvc.environment import child_environment, python_module
from dvc.web.plotting import new_figure

if TYPE_CHECKING:
    from dvc.video import Frame

QPS, PROVEN_QP, SHOWN_QP = (36, 30), 36, 30
"""Qualities of the codec; the one that is coded in every way; the one that is drawn."""
ANCHOR_QPS = {"H.264 intra": (40, 36, 32), "x264 medium": (40, 36, 32, 28)}
NUM_FRAMES = 9
SIZE = "176x144"
Luma = NDArray[np.uint8]


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
    _draw(video, folder)
    print(f"\nfiles are in {folder}; look at {folder / 'demo.png'}")
    return 0


def _render(folder: Path) -> Path:
    print("rendering a camera that moves along a street ...", flush=True)
    video = folder / "street.mkv"
    _run("sequences", "render", "street", "--size", SIZE, "--frames", NUM_FRAMES, "--out", video)
    return video


def _run(module: str, *arguments: object) -> None:
    subprocess.run(python_module(module, *arguments), env=child_environment(), check=True)


def _options(qp: int) -> list[object]:
    return ["--qp", qp, "--quiet"]


def _outputs(folder: Path, name: str) -> list[object]:
    return [folder / f"{name}.mkv", "--punctured", folder / f"{name}_punctured.dvc", "--quiet"]


def _code(video: Path, folder: Path, qp: int) -> dict[str, Any]:
    """Encode in one process, decode in another; return the report."""
    name = f"qp{qp}"
    stream, report = folder / f"{name}.dvc", folder / f"{name}.json"
    _run("encoder", video, stream, *_options(qp))
    predicted = ["--side-information-video", folder / f"{name}_predicted.mkv"]
    _run("decoder", stream, *_outputs(folder, name), *predicted, "--reference", video, "--json", report)
    return _report(report)


def _prove(video: Path, folder: Path, wait: Any) -> None:
    """Decode the punctured stream in a fresh process, and code the same live: all must be the same."""
    wait()
    name = f"qp{PROVEN_QP}"
    _run("decoder", folder / f"{name}_punctured.dvc", *_outputs(folder, "again"))
    command = python_module("encoder", video, "--serve", "127.0.0.1:0", *_options(PROVEN_QP))
    with subprocess.Popen(command, env=child_environment(), stderr=subprocess.PIPE, text=True) as server:
        assert server.stderr is not None
        address = server.stderr.readline().split()[-1]
        try:
            _run("decoder", "--connect", address, *_outputs(folder, "live"))
        except BaseException:
            server.kill()
            raise
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
        _run("dvc.rd.anchors", "encode", video, stream, "--codec", anchor, "--qp", qp)
        _run("dvc.rd.anchors", "decode", stream, "--reference", video, "--json", report)
        rows.append(Row(f"{name}, QP {qp}", _report(report)["totals"]))
    return rows


def _report(path: Path) -> dict[str, Any]:
    values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return values


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
            cells += [
                f"{row.report['si_psnr_y_db']:.2f}",
                *(_saving(row, curve) for curve in curves.values()),
            ]
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


def _frame(path: Path, index: int) -> "Frame":
    from dvc.video import open_video

    with open_video(path, start=index, num_frames=1) as reader:
        return next(iter(reader))


def _colours(frame: "Frame") -> NDArray[np.uint8]:
    from dvc.video.pixels import picture_from_frame

    picture = picture_from_frame(frame.with_chroma(), "yuv420p")
    return np.asarray(picture.to_ndarray(format="rgb24"), np.uint8)


def _depth(first: Luma, second: Luma) -> NDArray[np.float64] | None:
    """Return inverse depth as the decoder finds it between two frames without tracks; None: no scene."""
    from dvc.geometry.depth_maps import estimate_depths
    from sfm.pipeline import reconstruct

    model = reconstruct(first, second).model
    if model is None:
        return None
    return estimate_depths(model.view_pair, first, second)[0].depth.inverse_depth


def _draw(video: Path, folder: Path) -> None:
    """Draw how one Wyner-Ziv frame comes about: key frame, depth, prediction, decoded frame."""
    name = f"qp{SHOWN_QP}"
    types = [frame["type"] for frame in _report(folder / f"{name}.json")["per_frame"]]
    shown, last = len(types) // 2, len(types) - 1
    decoded = folder / f"{name}.mkv"
    original, key = _frame(video, shown), _frame(decoded, 0)
    depth = _depth(key.luma, _frame(decoded, last).luma)
    panels: list[tuple[NDArray[Any], str]] = [(_colours(key), "frame 0: a key frame, as decoded")]
    for path, label in ((folder / f"{name}_predicted.mkv", "predicted"), (decoded, "decoded")):
        frame = _frame(path, shown)
        panels.append((_colours(frame), f"frame {shown}, {label}: luma {_db(original, frame)}"))
    seen, title = np.zeros(key.luma.shape), "no depth: no scene that can be trusted"
    if depth is not None:
        seen, title = depth, "depth, from decoded frames (bright is near)"
    panels.insert(1, (seen, title))
    with new_figure((16, 3.7)) as figure:
        axes = figure.subplots(1, len(panels))
        for place, (picture, title) in zip(axes, panels, strict=True):
            place.imshow(picture, cmap="viridis", vmin=0, vmax=float(max(np.percentile(seen, 99), 1e-9)))
            place.set_title(title)
            place.axis("off")
        figure.savefig(folder / "demo.png", dpi=90)


def _db(original: "Frame", frame: "Frame") -> str:
    from dvc.metrics import psnr_db

    return f"{psnr_db(original.luma, frame.luma):.1f} dB"


if __name__ == "__main__":
    sys.exit(main())
