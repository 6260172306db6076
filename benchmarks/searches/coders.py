"""Which coder of planes wins where: bytes and processor time of the decoder, at the same frames.

``python -m benchmarks.searches.coders CLIP ... [--points qp=30 wz-q=4] [--frames 9]`` codes and decodes each
clip with every coder in processes of their own, one at a time, and prints a row for each clip and quality.
"""

import argparse
import json
import resource
import subprocess
import tempfile
from pathlib import Path

from dvc.config import CODERS
from dvc.environment import child_environment, python_module

POINTS = ("qp=24", "qp=30", "qp=36", "wz-q=1", "wz-q=4", "wz-q=8")


def _cpu_s(*command: str) -> float:
    """Run a module of the project; return the processor time that it took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = child_environment() | {"OMP_NUM_THREADS": "1"}
    subprocess.run(python_module(*command), env=environment, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(clip: Path, point: str, coder: str, options: list[str]) -> tuple[int, float, float]:
    """Return bytes of the punctured stream, PSNR of its frames, and the decoder's processor time."""
    with tempfile.TemporaryDirectory() as folder:
        stream, punctured, report = (
            f"{folder}/{name}" for name in ("all.dvc", "punctured.dvc", "report.json")
        )
        quality, value = point.split("=")
        _cpu_s("encoder", str(clip), stream, f"--{quality}", value, "--coder", coder, "--quiet", *options)
        cpu_s = _cpu_s(
            "decoder", stream, f"{folder}/frames.y4m", "--punctured", punctured, "--json", report,
            "--reference", str(clip), "--jobs", "1", "--quiet",
        )  # fmt: skip
        psnr_db = json.loads(Path(report).read_text(encoding="utf-8"))["psnr_y_db"]
        return Path(punctured).stat().st_size, psnr_db, cpu_s


def main() -> None:
    """Print a row for each clip and quality."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clips", type=Path, nargs="+")
    parser.add_argument("--points", nargs="+", default=POINTS)
    parser.add_argument("--coders", nargs="+", default=CODERS)
    parser.add_argument("--frames", default="9")
    parser.add_argument("--codec", default="3d-te")
    arguments = parser.parse_args()
    options = ["--frames", arguments.frames, "--luma-only", "--codec", arguments.codec]
    print("clip     point   ", *(f"{coder:>10}: bytes, dB, CPU s" for coder in arguments.coders))
    for clip in arguments.clips:
        for point in arguments.points:
            found = [measure(clip, point, coder, options) for coder in arguments.coders]
            cells = (f"{size:>12} {psnr_db:>7.3f} {cpu_s:>6.1f}" for size, psnr_db, cpu_s in found)
            print(f"{clip.stem:<8} {point:<8}", *cells, flush=True)


if __name__ == "__main__":
    main()
