"""Command ``dvc-compile``: run each program on a few small frames, so that its kernels are in the cache.

Each line of `CHAINS` is a command; its files are in a temporary folder, and the next line may read them.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

from dvc import cli
from dvc.environment import COMPILATION_NOTICE, child_environment, python_module
from dvc.errors import DvcError
from dvc.versions import CODEC, library_versions, packages_digest

PROG = "dvc-compile"
EXAMPLES = """\
  dvc-compile
  dvc-compile --jobs 4
"""
CHAINS = {
    "rendered scene": """
        sequences render street --size 128x96 --frames 9 --out street.mkv
        encoder street.mkv street.dvc --qp 30
        decoder street.dvc decoded.y4m --reference street.mkv --punctured small.dvc
        encoder street.mkv limited.dvc --no-feedback
        decoder limited.dvc limited.y4m
        encoder street.mkv views.dvc --codec 3d-td --gop 3 --wz-q 6 --frames 4
        decoder views.dvc views.y4m
        decoder views.dvc fused.y4m --side-information fused
        encoder street.mkv classical.dvc --coder turbo --gop 3 --min-gop 3 --wz-q 4 --frames 4
        decoder classical.dvc mesh.y4m --side-information mesh
        decoder classical.dvc blocks.y4m --side-information blocks
        sfm street.mkv --out map
        sfm street.mkv street.mkv --frames 0 8 --out model
        sequences render toy --size 64x48 --out toy
    """,
    "pictures with depth": """
        dvc.stereo reconstruct {views} --disparities 0:6 --out surfaces
        dvc.stereo reconstruct {views} --disparities 0:6:0.5 {lattice} --cost squared --sub-pixel --out finer
        dvc.stereo reconstruct {views} --disparities 0:6 {paths} --out paths
        dvc.stereo reconstruct {views} --disparities 0:6 --occlusion none --out open
        dvc.stereo layers surfaces --out layers
        dvc.stereo sprites layers --out sprites
        dvc.dibr encode {views} l.dibr --disparities 0:6 --bpp 1
        dvc.dibr encode {views} s.dibr --disparities 0:6 --bpp 1 --disparity s
        dvc.dibr encode {views} quadtree.dibr --disparities 0:6 --bpp 1 --disparity quadtree
        dvc.dibr encode {views} blocks.dibr --disparities 0:6 --bpp 1 --disparity blocks
        dvc.dibr encode {views} fine.dibr --disparities 0:6:0.5 --bpp 1 --quality-layers 2
        dvc.dibr encode {depth} depth.dibr --bpp 1 --edges auto
        dvc.dibr encode {depth} canny.dibr --bpp 1 --edges canny
        dvc.dibr encode {depth} standard.dibr --bpp 1 --transform standard --wavelet 5/3
        dvc.dibr encode left.png image.dibr --depth {depth} --bpp 1
        dvc.dibr encode layers pieces.dibr --bpp 1 --keep all
        dvc.dibr encode sprites sprites.dibr --bpp 1
        dvc.dibr render l.dibr --view 0.5,0 --out l.png
        dvc.dibr render image.dibr --view 0.5,0 --out image.png
        dvc.dibr render pieces.dibr --view 0.5,0 --out pieces.png
        dvc.dibr decode depth.dibr --out depth
    """,
    "moving texture": """
        encoder texture.y4m texture.dvc --codec 2d --wz-q 5 --gop 4
        decoder texture.dvc texture-decoded.y4m
        encoder texture.y4m best.dvc --codec 2d --wz-q 4 --key-qp lossless --coder turbo
        decoder best.dvc best.y4m
        encoder texture.y4m tracked.dvc
        encoder texture.y4m bounded.dvc --no-feedback --bitrate 40k
    """,
}
WORDS = {
    "depth": "surfaces/disparity-left.pfm",
    "lattice": "--lattice 0,0 1.03,0.37",
    "paths": "--inference semi-global --occlusion implicit",
    "views": "left.png right.png",
}
"""Parts of commands."""


def commands(chain: str) -> list[list[str]]:
    """Return the commands of a chain."""
    return [line.split() for line in CHAINS[chain].format(**WORDS).strip().splitlines()]


def _parser() -> argparse.ArgumentParser:
    text = "Compile the kernels of all programs that are installed, by running each on a few small frames."
    parser = cli.ArgumentParser(PROG, text, EXAMPLES)
    jobs = "programs that run at the same time"
    cli.add_integer(parser, "--jobs", (1, 256), jobs, default=len(os.sched_getaffinity(0)))
    return parser


def _compile(arguments: argparse.Namespace) -> int:
    from dvc._jit import cache_folder

    started_s = time.monotonic()
    environment = [f"{name}={value}" for name, value in os.environ.items() if name.startswith("NUMBA_")]
    parts = [packages_digest([*CODEC, "sequences"]), library_versions(), sys.version, sorted(environment)]
    done_file = cache_folder() / f"compiled-{sha256(repr(parts).encode()).hexdigest()[:16]}"
    if done_file.exists():
        sys.stdout.write(f"kernels have been compiled in {cache_folder()}\n")
        return 0
    total = sum(len(commands(chain)) for chain in CHAINS)
    with (
        tempfile.TemporaryDirectory() as name,
        cli.progress_bar("compiling", total) as done,
        ThreadPoolExecutor(arguments.jobs) as pool,
    ):
        folder = Path(name)
        _write_inputs(folder)

        def run_chain(chain: str) -> bool:
            """Run the commands of a chain; return whether all are installed."""
            for words in commands(chain):
                process = subprocess.run(
                    python_module(words[0], *words[1:]),
                    env=child_environment() | {COMPILATION_NOTICE: ""},
                    cwd=folder,
                    capture_output=True,
                    check=False,
                    text=True,
                    errors="replace",
                )
                if "pip install 'dvc3d[" in process.stderr:  # the command is not installed
                    return False
                if process.returncode:
                    problem = process.stderr.strip() or f"status {process.returncode}"
                    raise DvcError(f"{' '.join(words)}: {problem}")
                done(1, " ".join(words[:2]))
            return True

        futures = [pool.submit(run_chain, chain) for chain in CHAINS]
        if all(future.result() for future in futures):
            done_file.touch()
    seconds = time.monotonic() - started_s
    sys.stdout.write(f"kernels are compiled in {cache_folder()}, after {seconds:.0f} s\n")
    return 0


def _write_inputs(folder: Path) -> None:
    """Write two views, and a clip, of a texture that moves."""
    import cv2
    import numpy as np

    from dvc.picture_files import write_png
    from dvc.video import Frame, create_video

    noise = np.random.default_rng(0).normal(size=(120, 160)).astype(np.float32)
    texture = cv2.GaussianBlur(noise, (0, 0), 1.2) * 100 + cv2.GaussianBlur(noise, (0, 0), 6.0) * 300 + 128
    luma = np.clip(texture, 16, 235).astype(np.uint8)
    left, right = luma[:48, :64].copy(), np.roll(luma, -1, axis=1)[:48, :64].copy()
    right[12:36, 20:44] = np.roll(luma, -5, axis=1)[12:36, 20:44]
    write_png(folder / "left.png", left)
    write_png(folder / "right.png", right)
    with create_video(folder / "texture.y4m", (96, 80), 25) as clip:
        for index in range(9):
            frame = np.ascontiguousarray(luma[index : 80 + index, 2 * index : 96 + 2 * index])
            chroma = np.full((40, 48), 110 + index, np.uint8)
            clip.write(Frame(frame, (chroma, chroma)))


main = cli.command(PROG, _parser, _compile)

if __name__ == "__main__":
    sys.exit(main())
