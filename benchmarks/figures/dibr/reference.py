"""The codec of the reference view against JPEG 2000, and how long it takes."""

import io
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import skimage.data
from numpy.typing import NDArray
from PIL import Image

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.stereo.runs import data_folder
from dvc.dibr.reference import codec
from dvc.metrics import psnr_db

AREA = "dibr"
PHOTOGRAPHS = ("camera", "astronaut", "brick", "grass", "gravel", "moon")
RATES_BPP = (0.25, 0.5, 1.0)
CONTAINER_BYTES = 16
"""Counted with the data: header of the codec, and size and checks as a container has them."""

Gray = NDArray[np.uint8]


def photograph(name: str) -> Gray:
    """Read a photograph of 512x512 pixels that scikit-image brings along."""
    path = Path(skimage.data.__file__).parent / f"{name}.png"
    return np.asarray(Image.open(path).convert("L"))


def jpeg2000(picture: Gray, max_bytes: int) -> Gray:
    """Code a picture by Pillow's JPEG 2000, 9/7, one layer, as near below a size as its rate control gets."""
    low, high = 0.5 * picture.size / max_bytes, 3.0 * picture.size / max_bytes
    best = b""
    for _ in range(12):
        ratio, file = (low + high) / 2.0, io.BytesIO()
        Image.fromarray(picture).save(
            file, "JPEG2000", quality_mode="rates", quality_layers=[ratio], irreversible=True
        )
        if file.tell() <= max_bytes:
            best, high = max(best, file.getvalue(), key=len), ratio
        else:
            low = ratio
    return np.asarray(Image.open(io.BytesIO(best)))


def spiht(picture: Gray, max_bytes: int, adaptive: bool = True) -> Gray:
    """Code a picture by the codec of the reference view."""
    code = codec.encode(picture, max_bytes - CONTAINER_BYTES, adaptive=adaptive)
    header, data = code.cut(max_bytes - CONTAINER_BYTES)
    return codec.decode(header, data, code.shape).picture()


def against_jpeg2000(setting: Setting, clip: str, rate_bpp: float) -> Measured:
    """Compare PSNR at equal sizes of files, on each photograph."""
    del clip
    values: dict[str, dict[str, float]] = {}
    for name in PHOTOGRAPHS[: setting.choose(len(PHOTOGRAPHS), 1)]:
        picture = photograph(name)
        max_bytes = round(picture.size * rate_bpp / 8)
        values[name] = {
            "jpeg2000_db": psnr_db(jpeg2000(picture, max_bytes), picture),
            "spiht_db": psnr_db(spiht(picture, max_bytes), picture),
            "plain_db": psnr_db(spiht(picture, max_bytes, adaptive=False), picture),
        }
    gains = [each["spiht_db"] - each["jpeg2000_db"] for each in values.values()]
    plain = [each["plain_db"] - each["jpeg2000_db"] for each in values.values()]
    text = f"{np.mean(gains):+.2f} dB on average, {min(gains):+.2f} at least"
    note = f"plain bits: {np.mean(plain):+.2f} and {min(plain):+.2f} dB"
    return Measured(text, min(gains) >= -0.3, dict(values), note)


def _least_seconds(repetitions: int, function: Callable[[], object]) -> float:
    times = []
    for _ in range(repetitions + 1):  # the first may compile
        started = time.perf_counter()
        function()
        times.append(time.perf_counter() - started)
    return min(times[1:])


def speed(setting: Setting, clip: str) -> Measured:
    """Measure encoding and decoding of a gray view of Teddy at 1 bpp, kernels compiled."""
    del clip
    picture = np.asarray(Image.open(data_folder("teddy") / "teddy" / "im2.png").convert("L"))
    max_bytes = picture.size // 8
    repetitions = setting.choose(5, 1)
    encode_s = _least_seconds(repetitions, lambda: codec.encode(picture, max_bytes))
    code = codec.encode(picture, max_bytes)
    header, data = code.cut(max_bytes)
    decode_s = _least_seconds(repetitions, lambda: codec.decode(header, data, code.shape))
    values = {"encode_s": encode_s, "decode_s": decode_s}
    return Measured(f"{encode_s:.2f} s and {decode_s:.2f} s", encode_s + decode_s <= 0.5, values)


FIGURES = (
    *(
        Figure(
            AREA,
            f"jpeg2000-{rate_bpp:g}-bpp",
            f"reference view codec against Pillow's JPEG 2000 at {rate_bpp:g} bpp, whole files, PSNR of six "
            "photographs of 512x512",
            "within 0.3 dB on each",
            partial(against_jpeg2000, rate_bpp=rate_bpp),
        )
        for rate_bpp in RATES_BPP
    ),
    Figure(
        AREA,
        "reference-time",
        "encoding and decoding a gray view of 450x375 at 1 bpp, compiled",
        "≤ 0.5 s together",
        speed,
    ),
)
"""The figures of this module."""
