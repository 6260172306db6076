"""Code a moving camera between two processes, over files and live, and show what it costs: `make demo`."""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

QUANTISERS = (1, 4, 8)
INTRA_QPS = (42, 38, 33, 28, 24)
NUM_FRAMES = 9
SIZE = "176x144"


@dataclass(frozen=True)
class Row:
    """One line of the table: how the video was coded, and the report of the decoder."""

    name: str
    report: dict[str, Any]

    @property
    def rate_kbps(self) -> float:
        """Rate that was really needed."""
        return float(self.report["rate_kbps"])

    @property
    def psnr_db(self) -> float:
        """Mean PSNR of luma over all frames."""
        return float(self.report["psnr_y_db"])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demonstration.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process by default.

    Returns
    -------
    int
        Exit status.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for everything")
    parser.add_argument("--video", type=Path, help="code this instead of a rendered street")
    arguments = parser.parse_args(argv)
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    video = arguments.video or _render(folder)
    print("encoding and decoding in processes of their own ...", flush=True)
    with ThreadPoolExecutor(2) as pool:
        wyner_ziv = [pool.submit(_code, video, folder, f"wz{q}", ["--wz-q", str(q)]) for q in QUANTISERS]
        intra_options = [["--gop", "1", "--key-qp", str(qp)] for qp in INTRA_QPS]
        intra = [
            pool.submit(_code, video, folder, f"intra{options[-1]}", options) for options in intra_options
        ]
    rows = [Row(f"Wyner-Ziv, Q{q}", run.result()) for q, run in zip(QUANTISERS, wyner_ziv, strict=True)]
    anchor = [Row(f"H.264 intra, QP {qp}", run.result()) for qp, run in zip(INTRA_QPS, intra, strict=True)]
    print("the same live: the decoder asks the encoder for parity over TCP ...", flush=True)
    _code_live(video, folder, f"wz{QUANTISERS[-1]}", ["--wz-q", str(QUANTISERS[-1])])
    _print_table(rows, anchor)
    _draw(video, folder, rows, anchor)
    print(f"\nfiles are in {folder}; look at {folder / 'demo.png'}")
    return 0


def _render(folder: Path) -> Path:
    print("rendering a camera that moves along a street ...", flush=True)
    video = folder / "street.mkv"
    _run("sequences", "render", "street", "--size", SIZE, "--frames", str(NUM_FRAMES), "--out", str(video))
    return video


def _run(module: str, *arguments: str) -> None:
    subprocess.run([sys.executable, "-m", module, *arguments], check=True)


def _code(video: Path, folder: Path, name: str, options: list[str]) -> dict[str, Any]:
    """Encode in one process, decode in another, what was needed in a third; return the report."""
    stream, punctured, report = (folder / f"{name}{end}" for end in (".dvc", "_punctured.dvc", ".json"))
    decoded, again = folder / f"{name}.mkv", folder / f"{name}_punctured.mkv"
    _run("encoder", str(video), str(stream), "--luma-only", *options)
    reference = ["--reference", str(video), "--json", str(report), "--punctured", str(punctured)]
    _run("decoder", str(stream), str(decoded), *reference)
    if "--gop" not in options:
        _run("decoder", str(punctured), str(again))
        _check_same(decoded, again)
    values: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return values


def _code_live(video: Path, folder: Path, name: str, options: list[str]) -> None:
    """Run encoder and decoder at the same time, and check that frames and bits are those of the files."""
    command = [sys.executable, "-m", "encoder", str(video), "--luma-only", "--serve", "127.0.0.1:0", *options]
    decoded, punctured = folder / f"{name}_live.mkv", folder / f"{name}_live.dvc"
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as encoder:
        assert encoder.stderr is not None
        address = encoder.stderr.readline().split()[-1]
        try:
            _run("decoder", "--connect", address, str(decoded), "--punctured", str(punctured))
        except BaseException:
            encoder.kill()
            raise
    _check_same(decoded, folder / f"{name}.mkv")
    _check_same(punctured, folder / f"{name}_punctured.dvc")


def _check_same(a: Path, b: Path) -> None:
    if a.read_bytes() != b.read_bytes():
        raise SystemExit(f"{a} and {b} differ")


def _intra_rate_kbps(anchor: list[Row], psnr_db: float) -> float | None:
    """Rate at which intra coding reaches a PSNR, by interpolation; None beyond its points."""
    quality = np.array([row.psnr_db for row in anchor])
    if not quality[0] <= psnr_db <= quality[-1]:
        return None
    return float(np.exp(np.interp(psnr_db, quality, np.log([row.rate_kbps for row in anchor]))))


def _print_table(rows: list[Row], anchor: list[Row]) -> None:
    head = ("", "kbit/s", "PSNR", "key", "Wyner-Ziv", "prediction", "vs intra", "decoding")
    lines: list[tuple[str, ...]] = [head, ("", "", "dB", "dB", "dB", "dB", "at equal dB", "s per WZ frame")]
    for row in rows:
        report, intra = row.report, _intra_rate_kbps(anchor, row.psnr_db)
        num_wyner_ziv = sum(frame["type"] == "wz" for frame in report["per_frame"])
        quality = [report[name] for name in ("key_psnr_y_db", "wz_psnr_y_db", "si_psnr_y_db")]
        saving = "" if intra is None else f"{100 * (row.rate_kbps / intra - 1):+.1f} %"
        cells = [
            row.name,
            f"{row.rate_kbps:.1f}",
            f"{row.psnr_db:.2f}",
            *(f"{value:.2f}" for value in quality),
        ]
        lines.append((*cells, saving, f"{report['decode_s'] / num_wyner_ziv:.2f}"))
    lines += [(row.name, f"{row.rate_kbps:.1f}", f"{row.psnr_db:.2f}", *[""] * 5) for row in anchor]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    print()
    for line in lines:
        name, *cells = (cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        print("  ".join([name.strip().ljust(widths[0]), *cells]).rstrip())
    print("\nRates are sizes of the punctured files, which fresh processes decode to the same frames without")
    print("feedback; the live run gave the same frames and the same bits.")


def _luma(path: Path, index: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    from dvc.video import open_video

    with open_video(path, start=index, num_frames=1) as reader:
        return next(iter(reader)).luma


def _draw(video: Path, folder: Path, rows: list[Row], anchor: list[Row]) -> None:
    """Draw one Wyner-Ziv frame beside the original, and rate against quality."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    middle = rows[-1].report["frames"] // 4 * 2 + 1
    original, decoded = (_luma(path, middle) for path in (video, folder / f"wz{QUANTISERS[-1]}.mkv"))
    error = np.abs(original.astype(int) - decoded)
    figure, axes = plt.subplots(2, 2, figsize=(11, 9), layout="constrained")
    pictures = [
        (original, f"frame {middle}, original", 255),
        (decoded, f"Wyner-Ziv decoded, {rows[-1].name[-2:]}", 255),
    ]
    for place, (picture, title, white) in zip(
        axes.flat, [*pictures, (error, "error, 8 times", 32)], strict=False
    ):
        place.imshow(picture, cmap="gray", vmin=0, vmax=white, interpolation="nearest")
        place.set_title(title)
        place.axis("off")
    plot = axes[1, 1]
    for curve, name, style in ((rows, "Wyner-Ziv, GOP 2", "o-"), (anchor, "H.264 intra", "s--")):
        points = sorted((row.rate_kbps, row.psnr_db) for row in curve)
        plot.plot(*zip(*points, strict=True), style, label=name)
    plot.set(xlabel="rate, kbit/s", ylabel="luma PSNR, dB")
    plot.grid(alpha=0.3)
    plot.legend()
    figure.savefig(folder / "demo.png", dpi=110)


if __name__ == "__main__":
    sys.exit(main())
