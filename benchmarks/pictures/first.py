"""The first picture of the README: key frame, depth, prediction and decoded frame of the default codec."""

from pathlib import Path

from benchmarks.pictures.drawing import decoding_stages, scratch_files, write_picture
from benchmarks.results.harness import report_of, run_module

PICTURE = Path("docs/pictures/first.jpg")
SCENE = ("street", "--frames", "17")
QP = "30"
MAX_BYTES = 150_000


def draw() -> list[Path]:
    """Code the rendered street in processes, and draw a frame between two that are decoded before it."""
    with scratch_files("street.mkv", "street.dvc", "decoded.mkv", "predicted.mkv", "report.json") as files:
        video, stream, decoded, predicted, report = files
        run_module("sequences", "render", *SCENE, "--out", video)
        run_module("encoder", video, stream, "--qp", QP, "--quiet")
        outputs = ["--side-information-video", predicted, "--json", report, "--reference", video, "--quiet"]
        run_module("decoder", stream, decoded, *outputs)
        picture = decoding_stages(decoded, predicted, report_of(report)["per_frame"])
    return [write_picture(PICTURE, picture, MAX_BYTES)]
