"""Report of a run: bits, and PSNRs of luma, of chroma and in colour."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any, cast

import numpy as np
import pytest

from decoder.group_tasks import DecodedGroup
from decoder.report import BIT_CLASSES, PSNR_CAP_DB, DecodeReport
from dvc.config import CodecConfig, DiscoverMatrix, VideoConfig, codec_config
from dvc.errors import ConfigError, VideoError
from dvc.video import Frame, VideoInfo, VideoReader
from tests.clips import moving_texture
from tests.streams import decoded, encoded

FRAMES = moving_texture(6, 16, 24)


CONFIG = codec_config(VideoConfig(24, 16, 25, 1), "2d", DiscoverMatrix(2), gop={"length": 3}, key={"qp": 30})


@pytest.fixture(scope="module")
def groups() -> list[DecodedGroup]:
    return decoded(encoded(CONFIG, FRAMES))


class Reference:
    """The part of a video reader that a report looks at."""

    def __init__(self, frames: list[Frame], width: int = 24) -> None:
        self.info = VideoInfo(width, 16, Fraction(25))
        self._frames = frames

    def __iter__(self) -> Iterator[Frame]:
        return iter(self._frames)


def totals_of(
    groups: list[DecodedGroup], original: list[Frame] | None = None, config: CodecConfig = CONFIG
) -> dict[str, Any]:
    report = DecodeReport(config, None if original is None else cast(VideoReader, Reference(original)))
    for group in groups:
        report.add(group)
    return report.to_dict(stream_bytes=1000)


def test_report_accounts_for_every_bit(groups: list[DecodedGroup]) -> None:
    totals = totals_of(groups, FRAMES)
    planes = totals["plane_bits"]
    assert planes["all"]["bits"] == totals["bits"]["parity"] + totals["bits"]["crc"]
    assert planes["all"]["bits"] == sum(planes[name]["bits"] for name in planes if name != "all")
    assert planes["dc"]["ratio"] == round(planes["dc"]["bits"] / planes["dc"]["ideal_bits"], 4) > 1
    rows = totals["per_frame"]
    assert [row["index"] for row in rows] == list(range(6))
    assert [row["type"] for row in rows] == ["key", "wz", "wz", "key", "wz", "key"]
    assert sum(sum(row["bits"].values()) for row in rows) == 8000
    assert sum(totals["bits"].values()) == 8000
    assert tuple(totals["bits"]) == BIT_CLASSES
    assert totals["duration_s"] == pytest.approx(6 / 25)
    assert totals["rate_kbps"] == pytest.approx(8 / totals["duration_s"])
    assert totals["psnr_y_db"] == pytest.approx(np.mean([row["psnr_y_db"] for row in rows]))
    wyner_ziv = [row for row in rows if row["type"] == "wz"]
    assert totals["wz_psnr_y_db"] == pytest.approx(np.mean([row["psnr_y_db"] for row in wyner_ziv]))
    assert totals["num_requests"] == sum(row["num_requests"] for row in wyner_ziv)
    # Luma counts six times as much as either plane of chroma, in every frame.
    frames_db = [(6 * row["psnr_y_db"] + row["psnr_cb_db"] + row["psnr_cr_db"]) / 8 for row in rows]
    assert totals["psnr_yuv_db"] == pytest.approx(np.mean(frames_db))


def test_report_without_reference_has_no_quality(groups: list[DecodedGroup]) -> None:
    totals = totals_of(groups)
    assert totals["psnr_y_db"] is None
    assert totals["wz_psnr_y_db"] is None
    assert totals_of(groups[:1], [groups[0].key])["psnr_y_db"] == PSNR_CAP_DB
    grey = [frame.without_chroma() for frame in FRAMES]
    luma_only = replace(CONFIG, video=replace(CONFIG.video, luma_only=True))
    of_luma = totals_of(decoded(encoded(luma_only, FRAMES)), FRAMES, luma_only)
    for without in (totals, totals_of(groups, grey), of_luma):
        assert not {"psnr_cb_db", "psnr_cr_db", "psnr_yuv_db"} & set(without)


def test_a_report_that_nobody_reads_keeps_nothing(groups: list[DecodedGroup]) -> None:
    full, short = DecodeReport(CONFIG, None), DecodeReport(CONFIG, None, kept=False)
    for group in groups:
        assert [p.report for p in short.add(group)] == [p.report for p in full.add(group)]
    with pytest.raises(IndexError):
        short.to_dict(100)


def test_report_refuses_a_reference_that_does_not_fit(groups: list[DecodedGroup]) -> None:
    with pytest.raises(ConfigError, match="the stream of 24x16"):
        DecodeReport(CONFIG, cast(VideoReader, Reference(FRAMES, width=25)))
    report = DecodeReport(CONFIG, cast(VideoReader, Reference(FRAMES[:3])))
    report.add(groups[0])
    with pytest.raises(VideoError, match="ends before frame 3"):
        report.add(groups[1])
