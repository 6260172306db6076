"""PSNRs of a report: of luma, of chroma, and in colour."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decoder.group_tasks import DecodedGroup
from decoder.report import DecodeReport
from dvc.config import CodecConfig, DiscoverMatrix, VideoConfig, codec_config
from dvc.video import create_video, open_video
from tests.clips import moving_texture, write_clip
from tests.streams import decoded, encoded

FRAMES = moving_texture(3, 16, 24)


def _config(*, luma_only: bool) -> CodecConfig:
    return codec_config(VideoConfig(24, 16, 25, 1, luma_only), "2d", DiscoverMatrix(2), gop={"length": 2})


def _decoded(config: CodecConfig) -> list[DecodedGroup]:
    return decoded(encoded(config, FRAMES))


def _totals(config: CodecConfig, originals: Path | None) -> dict[str, Any]:
    if originals is None:
        report = DecodeReport(config, None)
        for group in _decoded(config):
            report.add(group)
        return report.to_dict(100)
    with open_video(originals) as reference:
        report = DecodeReport(config, reference)
        for group in _decoded(config):
            report.add(group)
        return report.to_dict(100)


@pytest.fixture
def originals(tmp_path: Path) -> Path:
    """Write the frames in colour."""
    return write_clip(tmp_path / "clip.mkv", FRAMES)


def test_psnr_in_colour_is_the_mean_of_frames(originals: Path) -> None:
    """Luma counts six times as much as either plane of chroma, in every frame."""
    totals = _totals(_config(luma_only=False), originals)
    rows = totals["per_frame"]
    frames_db = [(6 * row["psnr_y_db"] + row["psnr_cb_db"] + row["psnr_cr_db"]) / 8 for row in rows]
    assert len(rows) == len(FRAMES)
    assert totals["psnr_yuv_db"] == pytest.approx(np.mean(frames_db))


def test_without_chroma_or_reference_there_is_none(originals: Path, tmp_path: Path) -> None:
    grey = tmp_path / "grey.mkv"
    with create_video(grey, (24, 16), 25, luma_only=True) as writer:
        for frame in FRAMES:
            writer.write(frame.without_chroma())
    in_colour = _config(luma_only=False)
    for totals in (
        _totals(_config(luma_only=True), originals),
        _totals(in_colour, None),
        _totals(in_colour, grey),
    ):
        assert not {"psnr_cb_db", "psnr_cr_db", "psnr_yuv_db"} & set(totals)
