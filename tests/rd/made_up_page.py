"""Made-up results of several codecs on several sequences, with frames and pictures."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.rd.made_up import add_result, result_data

HOSTILE = "<script>window.stolen=1</script><img src=x onerror='window.stolen=1'>"
SEQUENCES = ("street", "stairway", HOSTILE)
CURVES: tuple[tuple[str, dict[str, str], float], ...] = (
    ("2d", {}, 1.0),
    ("2d", {"references": "hierarchical"}, 0.93),
    ("2d", {"noise-model": "band"}, 0.97),
    ("2d", {"note": "</script><b>"}, 1.04),
    ("h264-intra", {}, 1.3),
)
NUM_FRAMES = 17
SIDES_PX = {"street": (64, 48), "stairway": (64, 48), HOSTILE: (80, 64)}


def write_many(folder: Path, *, levels: int = 6, pictures: bool = True) -> Path:
    """Write the results of an experiment: 3 sequences, 5 curves."""
    rng = np.random.default_rng(5)
    for number, name in enumerate(SEQUENCES):
        for curve, (codec, options, factor) in enumerate(CURVES):
            for level in range(levels):
                data = _point(name, codec, options, level, factor * (1 + 0.2 * number), rng)
                stem = f"s{number}-c{curve}-q{level + 1}"
                if pictures:
                    data["pictures"] = _pictures(folder, name, stem, codec == "2d", level)
                add_result(folder, stem, data)
    return folder


def _point(
    name: str, codec: str, options: dict[str, str], level: int, factor: float, rng: np.random.Generator
) -> dict[str, Any]:
    rate_kbps, psnr_y_db = factor * 60 * 1.5**level, 28.0 + 1.8 * level + float(rng.normal(0, 0.05))
    data = result_data(rate_kbps, psnr_y_db, wz_q=level + 1, codec=codec)
    width, height = SIDES_PX[name]
    data["identity"] = f"{name}{codec}{sorted(options.items())}{level}"
    data["sequence"] |= {"name": name, "digest": f"d-{name}", "width": width, "height": height}
    data["options"] |= {"options": options, "frames": NUM_FRAMES}
    data["key"]["qp"] = 44 - 3 * level
    data["totals"] |= {"frames": NUM_FRAMES, "refined_si_psnr_y_db": 32.0}
    if codec == "h264-intra":
        data["options"]["key_qp"] = str(44 - 3 * level)
        data["totals"]["refined_si_psnr_y_db"] = None
    data["libraries"] = {"numpy": "2.0"}
    data["per_frame"] = [_frame(i, codec, psnr_y_db, rate_kbps, rng) for i in range(NUM_FRAMES)]
    return data


def _frame(
    index: int, codec: str, psnr_y_db: float, rate_kbps: float, rng: np.random.Generator
) -> dict[str, Any]:
    predicted = codec == "2d" and index % 2 == 1
    bits = int(rate_kbps * (25 if predicted else 60))
    row: dict[str, Any] = {"index": index, "type": "wz" if predicted else "key"}
    row["psnr_y_db"] = psnr_y_db + float(rng.normal(0, 0.3))
    row["bits"] = {"key": 0 if predicted else bits, "parity": bits if predicted else 0}
    if predicted:
        row["si_psnr_y_db"] = psnr_y_db - 4 + float(rng.normal(0, 0.4))
        row |= {"refined_si_psnr_y_db": row["si_psnr_y_db"] + 1.5, "num_requests": 40 + index}
        row |= {"decode_s": 1.5 + 0.1 * index}
    return row


def _pictures(folder: Path, name: str, stem: str, predicted: bool, level: int) -> dict[str, Any]:
    width, height = SIDES_PX[name]
    rng = np.random.default_rng(level)
    rows, columns = np.mgrid[:height, :width]
    original = np.uint8(128 + 60 * np.sin(columns / 6) + 40 * np.cos(rows / 5))
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    planes = {"original": original}
    for kind, sigma in (("decoded", 10.0 / (level + 1)), ("predicted", 12.0)):
        noisy = original + rng.normal(0, sigma, original.shape)
        planes[kind] = np.clip(noisy, 0, 255).astype(np.uint8)
    names: dict[str, Any] = {"index": NUM_FRAMES // 2 | 1}
    for kind, plane in planes.items():
        names[kind] = f"pictures/{stem}-{kind}.png"
        cv2.imwrite(str(folder / names[kind]), plane)
    if not predicted:
        names["predicted"] = None
    return names
