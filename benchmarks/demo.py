"""Code a moving camera between two processes, over files and live, and show what it costs: `make demo`."""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import decoder.__main__
import encoder.__main__

QUANTISERS = {"3d-te": (5, 2), "2d": (7, 4, 1)}
"""Of each codec, the longest run first; those of 2d reach as far as the qualities they are compared at."""
SHOWN, PROVEN = 5, 2
"""Quantisers of the run that is drawn, and of the one that is done in every way."""
INTRA_QPS = (42, 38, 33, 28, 23)
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


class Files(NamedTuple):
    """What a run leaves in the folder."""

    stream: Path
    decoded: Path
    punctured: Path
    predicted: Path
    report: Path

    @classmethod
    def named(cls, folder: Path, name: str) -> "Files":
        """Return the files of a run by its name."""
        ends = (".dvc", ".mkv", "_punctured.dvc", "_predicted.mkv", ".json")
        return cls(*(folder / f"{name}{end}" for end in ends))

    @property
    def outputs(self) -> list[str]:
        """Arguments of the decoder that write them."""
        words = [
            "--punctured",
            self.punctured,
            "--side-information-video",
            self.predicted,
            "--json",
            self.report,
        ]
        return [str(self.decoded), *map(str, words), "--quiet"]


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
        runs = {
            codec: [(q, pool.submit(_code, video, folder, codec, q)) for q in quantisers]
            for codec, quantisers in QUANTISERS.items()
        }
        intra = pool.submit(_code_intra, video, folder)
    curves = {
        codec: [Row(f"{codec}, Q{q}", run.result()) for q, run in reversed(submitted)]
        for codec, submitted in runs.items()
    }
    curves["H.264 intra"] = intra.result()
    _print_table(curves)
    _draw(video, folder, curves)
    print(f"\nfiles are in {folder}; look at {folder / 'demo.png'}")
    return 0


def _render(folder: Path) -> Path:
    print("rendering a camera that moves along a street ...", flush=True)
    video = folder / "street.mkv"
    _run("sequences", "render", "street", "--size", SIZE, "--frames", str(NUM_FRAMES), "--out", str(video))
    return video


def _run(module: str, *arguments: str) -> None:
    subprocess.run([sys.executable, "-m", module, *arguments], check=True)


def _code(video: Path, folder: Path, codec: str, quantiser: int) -> dict[str, Any]:
    """Encode in one process, decode in another; return the report."""
    files = Files.named(folder, f"{codec}_q{quantiser}")
    options = ["--codec", codec, "--wz-q", str(quantiser), "--luma-only", "--quiet"]
    _run("encoder", str(video), str(files.stream), *options)
    _run("decoder", str(files.stream), *files.outputs, "--reference", str(video))
    if (codec, quantiser) == ("3d-te", PROVEN):
        again = Files.named(folder, "again")
        _run("decoder", str(files.punctured), *again.outputs)
        _check_same(files, again)
        live = Files.named(folder, "live")
        _code_live(video, live, options)
        _check_same(files, live)
    return _report(files)


def _code_live(video: Path, live: Files, options: list[str]) -> None:
    """Run encoder and decoder at the same time; the decoder asks for parity over TCP."""
    command = [sys.executable, "-m", "encoder", str(video), "--serve", "127.0.0.1:0", *options]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        assert server.stderr is not None
        address = server.stderr.readline().split()[-1]
        try:
            _run("decoder", "--connect", address, *live.outputs)
        except BaseException:
            server.kill()
            raise


def _check_same(a: Files, b: Files) -> None:
    for one, other in ((a.decoded, b.decoded), (a.punctured, b.punctured)):
        if one.read_bytes() != other.read_bytes():
            raise SystemExit(f"{one} and {other} differ")


def _code_intra(video: Path, folder: Path) -> list[Row]:
    """Code key frames only, which no other process has a part in."""
    rows = []
    for qp in INTRA_QPS:
        files = Files.named(folder, f"intra_qp{qp}")
        options = ["--gop", "1", "--key-qp", str(qp), "--luma-only", "--quiet"]
        if encoder.__main__.main([str(video), str(files.stream), *options]):
            raise SystemExit(f"H.264 intra at QP {qp} failed")
        decoder.__main__.main([str(files.stream), *files.outputs, "--reference", str(video)])
        rows.append(Row(f"H.264 intra, QP {qp}", _report(files)))
    return rows


def _report(files: Files) -> dict[str, Any]:
    values: dict[str, Any] = json.loads(files.report.read_text(encoding="utf-8"))
    return values


def _saving(row: Row, curve: list[Row]) -> str:
    """Compare a rate with that of a curve at equal PSNR, by interpolation; empty beyond its points."""
    quality = np.array([point.psnr_db for point in curve])
    if row in curve or not quality[0] <= row.psnr_db <= quality[-1]:
        return ""
    rate = np.exp(np.interp(row.psnr_db, quality, np.log([point.rate_kbps for point in curve])))
    return f"{100 * (row.rate_kbps / rate - 1):+.1f} %"


def _print_table(curves: dict[str, list[Row]]) -> None:
    lines: list[tuple[str, ...]] = [
        ("", "kbit/s", "PSNR", "key", "Wyner-Ziv", "prediction", "rate vs 2D", "vs intra", "decoding"),
        ("", "", "dB", "dB", "dB", "dB", "at equal dB", "at equal dB", "s per WZ frame"),
    ]
    for row in (row for rows in curves.values() for row in rows):
        report = row.report
        num_wyner_ziv = sum(frame["type"] == "wz" for frame in report["per_frame"])
        cells = [row.name, f"{row.rate_kbps:.1f}", f"{row.psnr_db:.2f}"]
        if num_wyner_ziv:
            names = ("key_psnr_y_db", "wz_psnr_y_db", "si_psnr_y_db")
            cells += [f"{report[name]:.2f}" for name in names]
            cells += [_saving(row, curves["2d"]), _saving(row, curves["H.264 intra"])]
            cells.append(f"{report['decode_s'] / num_wyner_ziv:.2f}")
        lines.append((*cells, *[""] * (len(lines[0]) - len(cells))))
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    print()
    for line in lines:
        name, *cells = (cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        print("  ".join([name.strip().ljust(widths[0]), *cells]).rstrip())
    print(
        f"\nRates are sizes of the punctured files. A fresh process decoded that of 3d-te, Q{PROVEN}, without"
    )
    print("feedback, and the same was coded again live, over TCP: the same frames, the same bits.")


def _luma(path: Path, index: int) -> NDArray[np.uint8]:
    from dvc.video import open_video

    with open_video(path, start=index, num_frames=1) as reader:
        return next(iter(reader)).luma


def _depth(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.float64] | None:
    """Return inverse depth as the decoder finds it between key frames without tracks; None: no scene."""
    from dvc.multiview.depth_maps import estimate_depths
    from sfm.pipeline import reconstruct

    model = reconstruct(first, second).model
    if model is None:
        return None
    return estimate_depths(model.view_pair, first, second)[0].depth.inverse_depth


def _draw(video: Path, folder: Path, curves: dict[str, list[Row]]) -> None:
    """Draw how one Wyner-Ziv frame comes about, and rate against quality."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    files = Files.named(folder, f"3d-te_q{SHOWN}")
    first, second = _first_group([frame["type"] for frame in _report(files)["per_frame"]])
    shown = (first + second) // 2
    original, predicted, decoded = (
        _luma(path, shown).astype(float) for path in (video, files.predicted, files.decoded)
    )
    depth = _depth(_luma(files.decoded, first), _luma(files.decoded, second))
    seen = f"depth of frame {first}, from decoded frames (bright is near)"
    if depth is None:
        seen, depth = "no depth: no scene that can be trusted", np.zeros_like(original)
    figure, axes = plt.subplots(2, 3, figsize=(14, 8), layout="constrained")
    for place, picture, title, colours, white in (
        (axes[0, 0], original, f"frame {shown}, original", "gray", 255.0),
        (axes[0, 1], depth, seen, "viridis", float(np.percentile(depth, 99))),
        (
            axes[0, 2],
            predicted,
            f"predicted from frames {first} and {second}: {_db(original, predicted)}",
            "gray",
            255.0,
        ),
        (axes[1, 0], decoded, f"corrected by parity, Q{SHOWN}: {_db(original, decoded)}", "gray", 255.0),
        (axes[1, 1], np.abs(original - decoded), "remaining error, 8 times", "gray", 32.0),
    ):
        place.imshow(picture, cmap=colours, vmin=0, vmax=white)
        place.set_title(title)
        place.axis("off")
    _plot(axes[1, 2], curves)
    figure.savefig(folder / "demo.png", dpi=110)


def _first_group(types: list[str]) -> tuple[int, int]:
    """Return the key frames around the first Wyner-Ziv frames; twice the first frame if there are none."""
    if "wz" not in types:
        return 0, 0
    first = types.index("wz")
    return first - 1, types.index("key", first)


def _plot(place: Any, curves: dict[str, list[Row]]) -> None:
    for (name, rows), style in zip(curves.items(), ("o-", "^-", "s--"), strict=True):
        points = sorted((row.rate_kbps, row.psnr_db) for row in rows)
        place.plot(*zip(*points, strict=True), style, label=name)
    place.set(xlabel="rate, kbit/s", ylabel="luma PSNR, dB")
    place.grid(alpha=0.3)
    place.legend()


def _db(original: NDArray[np.float64], picture: NDArray[np.float64]) -> str:
    from dvc.metrics import psnr_db

    return f"{psnr_db(original.astype(np.uint8), picture.astype(np.uint8)):.1f} dB"


if __name__ == "__main__":
    sys.exit(main())
