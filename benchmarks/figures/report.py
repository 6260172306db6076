"""The report: time to make it, size of its page, time until a browser shows it, BD figures against a peer."""

import copy
import statistics
import time
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import Figure, Measured, Setting
from dvc.errors import DvcError
from dvc.metrics import bd_psnr, bd_rate
from dvc.rd.point_result import PointResult
from dvc.rd.results import read_results
from tests import browser

NUM_POINTS = 100
MOST_S = 20.0
MOST_BYTES = 8_000_000
MOST_PAINT_MS = 2000.0
MOST_DIFFERENCE = 1e-6
CURVE_POINTS = (5, 7)
SEED = 515
NOISE = 5.0
Values = NDArray[np.float64]


@cache
def report(folder: Path) -> tuple[float, int, Path]:
    """Make the page, the tables and the plots of 100 points."""
    from dvc.rd.report import write_reports

    target = folder / "report"
    target.mkdir(parents=True, exist_ok=True)
    results = _with_pictures(_points(folder), target)
    start = time.process_time()
    page, *_ = write_reports(results, [target / "report.html", target / "report.md"])
    return time.process_time() - start, page.stat().st_size, page


def making(setting: Setting, _clip: str) -> Measured:
    """Measure the time that the report of 100 points takes."""
    cpu_s, _, _ = report(setting.folder)
    return Measured(f"{cpu_s:.1f} s", cpu_s <= MOST_S, {"cpu_s": cpu_s})


def size(setting: Setting, _clip: str) -> Measured:
    """Measure the size of the page of 100 points."""
    _, size_bytes, _ = report(setting.folder)
    return Measured(f"{size_bytes / 1e6:.2f} MB", size_bytes <= MOST_BYTES, {"size_bytes": size_bytes})


def first_paint(setting: Setting, _clip: str) -> Measured:
    """Measure when Chromium paints the first contents of the page."""
    from playwright.sync_api import sync_playwright

    path = browser.find()
    if path is None:
        raise DvcError(browser.missing())
    _, _, page = report(setting.folder)
    paints_ms = []
    with sync_playwright() as playwright:
        for _ in range(setting.choose(5, 1)):
            started = playwright.chromium.launch(executable_path=path, args=list(browser.ARGUMENTS))
            opened = started.new_page()
            opened.goto(page.resolve().as_uri())
            entry = "performance.getEntriesByName('first-contentful-paint')[0]"
            browser.wait_until(opened, f"{entry} !== undefined")
            paints_ms.append(float(opened.evaluate(f"{entry}.startTime")))
            started.close()
    paint_ms = statistics.median(paints_ms)
    return Measured(f"{paint_ms / 1000:.2f} s", paint_ms <= MOST_PAINT_MS, {"paints_ms": paints_ms})


def bd_peer(setting: Setting, _clip: str) -> Measured:
    """Compare BD figures with those of the package `bjontegaard` on random curves."""
    import bjontegaard

    rng = np.random.default_rng(SEED)
    options = {"require_matching_points": False, "min_overlap": 0}
    worst, num_pairs = 0.0, setting.choose(500, 20)
    for _ in range(num_pairs):
        pair = (*_rising_curve(rng, CURVE_POINTS[0]), *_rising_curve(rng, CURVE_POINTS[1]))
        for method in ("pchip", "cubic"):
            for ours, theirs in ((bd_rate, bjontegaard.bd_rate), (bd_psnr, bjontegaard.bd_psnr)):
                got = ours(*map(list, pair), method=method).value
                worst = max(worst, abs(got - float(theirs(*pair, method, **options))))
    values = {"largest_difference": worst, "num_pairs": num_pairs}
    return Measured(f"at most {worst:.1e} on {num_pairs} pairs", worst <= MOST_DIFFERENCE, values)


def _points(folder: Path) -> list[PointResult]:
    """Return 100 measured points; copies at other rates stand for further curves where there are fewer."""
    folders = sorted(path.parent for path in (folder / "rd").glob("*/points"))
    measured = [result for path in folders for result in read_results(path)]
    if not measured:
        raise DvcError(f"no points in {folder / 'rd'}; measure the area rd first")
    results = list(measured[:NUM_POINTS])
    copies = 0
    while len(results) < NUM_POINTS:
        copies += 1
        for result in measured[: NUM_POINTS - len(results)]:
            data = copy.deepcopy(result.data)
            data["sequence"]["digest"] += f"-{copies}"
            data["totals"]["rate_kbps"] *= 1 + 0.1 * copies
            results.append(PointResult(f"{result.name}-{copies}", data))
    return results


def _with_pictures(results: list[PointResult], folder: Path) -> list[PointResult]:
    """Give every point pictures of its size: waves with noise, which take more room than camera pictures."""
    import cv2

    rng = np.random.default_rng(SEED)
    for number, result in enumerate(results):
        sequence = result.data["sequence"]
        rows, columns = np.mgrid[: sequence["height"], : sequence["width"]]
        waves = 128 + 50 * np.sin(columns / 9) + 40 * np.cos(rows / 7)
        names = {}
        for kind in ("original", "decoded", "predicted"):
            names[kind] = str(folder / f"{number}-{kind}.png")
            noisy = np.clip(waves + rng.normal(0, NOISE, waves.shape), 0, 255).astype(np.uint8)
            cv2.imwrite(names[kind], noisy)
        result.data["pictures"] = {"index": 1, **names}
    return results


def _rising_curve(rng: np.random.Generator, count: int) -> tuple[Values, Values]:
    rates = 100 * np.cumprod(1 + rng.uniform(0.2, 0.8, count))
    psnrs = 28 + np.cumsum(rng.uniform(0.5, 2.0, count))
    return np.asarray(rates, np.float64), np.asarray(psnrs, np.float64)


AREA = "report"
FIGURES = (
    Figure(AREA, "time", "report of 100 points: page, table and plots", "≤ 20 s", making),
    Figure(AREA, "size", "page of 100 points", "≤ 8 MB", size),
    Figure(AREA, "first-paint", "first paint of that page in Chromium", "≤ 2 s", first_paint),
    Figure(AREA, "bd-peer", "BD figures against `bjontegaard`, random curves", "equal to 1e-6", bd_peer),
)
"""Figures of this area."""
