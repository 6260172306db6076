"""Made-up results for the tests of reports."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from dvc.metrics import psnr_yuv_db
from dvc.rd.rd_results import POINTS_FOLDER
from dvc.rd.specification import SCHEMA
from dvc.video import Frame, create_video


def result_data(
    rate_kbps: float,
    psnr_y_db: float,
    *,
    wz_q: int | None = 1,
    codec: str = "2d",
    chroma_db: float | None = None,
    **changes: Any,
) -> dict[str, Any]:
    """Return the contents of a result file, with a PSNR of chroma in colour."""
    wyner_ziv = codec != "h264-intra"
    totals: dict[str, Any] = {"frames": 3, "duration_s": 0.12, "stream_bytes": 1000}
    totals |= {"rate_kbps": rate_kbps, "psnr_y_db": psnr_y_db}
    totals |= {"bits": {"key": 6000, "tracks": 0, "parity": 1600, "crc": 80, "header": 320}}
    if chroma_db is not None:
        yuv_db = psnr_yuv_db(psnr_y_db, chroma_db, chroma_db)
        totals |= {"psnr_cb_db": chroma_db, "psnr_cr_db": chroma_db, "psnr_yuv_db": yuv_db}
    if wyner_ziv:
        totals |= {"si_psnr_y_db": 30.0, "num_requests": 12, "decode_s": 0.5, "wz_psnr_y_db": 31.0}
    return {
        "schema": SCHEMA,
        "identity": "0" * 32,
        "date": "2026-01-31T12:00:00+00:00",
        "sequence": {"name": "clip", "digest": "d1", "width": 64, "height": 48, "frames_per_s": 25.0},
        "codec": codec,
        "options": {
            "codec": codec,
            "wz_q": wz_q if wyner_ziv else None,
            "key_qp": "auto",
            "gop": 2 if wyner_ziv else 1,
            "start": 0,
            "frames": 3,
            "luma_only": chroma_db is None,
            "options": {},
        },
        "code": {"version": "0.0", "commit": None, "digest": "c1"},
        "commands": ["python -m encoder clip.mkv stream.dvc"],
        "key": {"qp": 34, "lossless": False},
        "totals": totals,
        "times": {
            "encode_cpu_s": 1.0,
            "decode_cpu_s": 2.0,
            "coding_cpu_s": 0.003,
            "key_encode_cpu_s": 0.002 if wyner_ziv else 0.003,
            "wz_encode_cpu_s": 0.001 if wyner_ziv else 0.0,
            "encode_start_up_cpu_s": 0.9,
        },
        "per_frame": [{"type": "key"}, {"type": "wz" if wyner_ziv else "key"}, {"type": "key"}],
        **changes,
    }


def add_result(folder: Path, name: str, data: object) -> Path:
    """Write one result of an experiment, or a damaged file if `data` is text."""
    path = folder / POINTS_FOLDER / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(data if isinstance(data, str) else json.dumps(data), encoding="utf-8")
    return path


def write_results(folder: Path, scale: float = 1.0) -> Path:
    """Write a codec's curve, and an intra curve of a quarter more rate."""
    for number, (rate_kbps, psnr_y_db) in enumerate([(60.0, 29.0), (90.0, 31.5), (200.0, 35.0)], start=1):
        codec = result_data(scale * rate_kbps, psnr_y_db, wz_q=number)
        intra = result_data(1.25 * scale * rate_kbps, psnr_y_db, codec="h264-intra")
        for name, data in ((f"codec-{number}", codec), (f"intra-{number}", intra)):
            add_result(folder, name, data)
    return folder


def write_colour_results(folder: Path) -> Path:
    """Write a codec's curve and an intra curve in colour: a fifth less rate by luma, none by all planes."""
    lead_db = 3.0 * math.log2(1.25)  # as 3 dB take twice the rate; chroma makes up for it
    for number, (rate_kbps, psnr_y_db) in enumerate([(60.0, 29.0), (120.0, 32.0), (240.0, 35.0)], start=1):
        codec = result_data(rate_kbps, psnr_y_db, wz_q=number, chroma_db=38.0 + number)
        chroma_db = 38.0 + number + 3.0 * lead_db
        intra = result_data(rate_kbps, psnr_y_db - lead_db, codec="h264-intra", chroma_db=chroma_db)
        for name, data in ((f"codec-{number}", codec), (f"intra-{number}", intra)):
            add_result(folder, name, data)
    return folder


def write_noise(path: Path) -> Path:
    """Write a clip of two frames of noise."""
    rng = np.random.default_rng(4)
    with create_video(path, (48, 32), 25) as writer:
        for _ in range(2):
            writer.write(Frame(rng.integers(60, 190, (32, 48)).astype(np.uint8)))
    return path
