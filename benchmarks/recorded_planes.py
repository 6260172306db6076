"""Bit planes with their side information, recorded from real decoding, and what codes need for them.

``python -m benchmarks.recorded_planes record STREAM.dvc PLANES.npz`` decodes a buffered stream and keeps its
planes; ``python -m benchmarks.recorded_planes judge cascade PLANES.npz ...`` codes them again and prints all
bits over their ideal code length, by class: the planes, and so the ideal, are the same for any code.
``python -m benchmarks.recorded_planes priors STREAM.dvc ...`` decodes streams with priors that learn,
and prints the ideal code length over that by the noise model alone, with the same predictions.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from decoder.group import GroupDecoder
from decoder.report import PLANE_CLASSES
from decoder.session import stream_tasks
from decoder.tasks import GroupTask, following
from decoder.wyner_ziv import REQUESTS
from dvc import slepian_wolf
from dvc.config import TURBO_FAMILIES
from dvc.slepian_wolf.results import PlaneCoroutine
from dvc.stream import Form, StreamReader
from dvc.wynerziv import priors
from dvc.wynerziv.quantizer import FrameLayout

Bits = NDArray[np.uint8]
SEED = 1


@dataclass
class _Recorder:
    """Decodes planes as another decoder does, and keeps them."""

    inner: slepian_wolf.PlaneDecoder
    planes: dict[tuple[int, int], tuple[NDArray[np.float32], Bits]] = field(default_factory=dict)

    @property
    def cost(self) -> slepian_wolf.PlaneCost:
        """What planes are expected to cost."""
        return self.inner.cost

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        place: tuple[int, int],
        coupling: slepian_wolf.NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        result = yield from self.inner.decode(llr_ch, place, coupling)
        self.planes[place] = np.asarray(llr_ch, np.float32), result.bits
        return result

    def check(self, frame: int) -> Any:
        check = yield from self.inner.check(frame)
        for plane, result in check.corrected.items():
            self.planes[frame, plane] = self.planes[frame, plane][0], result.bits
        return check


@contextmanager
def _recording() -> Iterator[list[_Recorder]]:
    """Let all decoders of planes that are made keep what they decode."""
    made: list[_Recorder] = []
    original = slepian_wolf.plane_decoder

    def _make(settings: slepian_wolf.SlepianWolfSettings, num_bits: int, seed: int) -> _Recorder:
        made.append(_Recorder(original(settings, num_bits, seed)))
        return made[-1]

    slepian_wolf.plane_decoder = _make
    try:
        yield made
    finally:
        slepian_wolf.plane_decoder = original


def _ideal_bits(llr: NDArray[np.floating], bits: Bits) -> float:
    bounded = np.clip(llr.astype(np.float64), -REQUESTS.max_prior_llr, REQUESTS.max_prior_llr)
    return float(np.logaddexp(0.0, np.where(bits == 1, bounded, -bounded)).sum() / np.log(2.0))


def measure_priors(stream: Path) -> dict[str, tuple[float, float]]:
    """Decode a buffered stream with learned priors, and compare these with the noise model alone."""
    lengths: dict[str, tuple[float, float]] = {}
    learn = priors.LearnedPriors.learn

    def _measure(self: priors.LearnedPriors, prior: priors.PlanePrior, bits: Bits) -> None:
        (name,) = (name for name, own in PLANE_CLASSES.items() if prior.place[0] in own)
        before, after = lengths.get(name, (0.0, 0.0))
        before += _ideal_bits(prior.inputs[0], bits)
        lengths[name] = before, after + _ideal_bits(prior.coupling.llr_in_sequence(bits), bits)
        learn(self, prior, bits)

    with StreamReader(stream) as reader, mock.patch.object(priors.LearnedPriors, "learn", _measure):
        if reader.form is not Form.BUFFERED or reader.config.wyner_ziv.priors == "laplacian":
            raise ValueError(f"`stream` must be buffered and have learned priors, got {stream}")
        for _ in _decoded(reader):
            pass
    return lengths


def _decoded(reader: StreamReader) -> Iterator[GroupTask]:
    """Decode a stream in this process, group by group."""
    decoder = GroupDecoder(reader.config)
    for chain in stream_tasks(reader.config, reader):
        group = None
        for task in chain:
            group = decoder.decode(following(task, group))
            yield task


def record(stream: Path, output: Path) -> int:
    """Decode a buffered stream and keep its bit planes."""
    bands: dict[tuple[int, int], int] = {}
    with StreamReader(stream) as reader, _recording() as recorders:
        if reader.form is not Form.BUFFERED:
            raise ValueError(f"`stream` must be buffered, got {stream}")
        layout = FrameLayout.of(reader.config)
        for task in _decoded(reader):
            for index, payload in enumerate(task.record.wyner_ziv, task.first_index):
                planes = layout.read_header(payload).planes
                names = [band for band, count in enumerate(planes) for _ in range(count)]
                bands |= {(index, plane): band for plane, band in enumerate(names)}
    found = {place: plane for recorder in recorders for place, plane in recorder.planes.items()}
    llr, bits = zip(*found.values(), strict=True)
    places = list(found)
    np.savez_compressed(
        output,
        places=places,
        bands=[bands[place] for place in places],
        llr=np.stack(llr),
        bits=np.stack(bits),
    )
    return len(found)


class FrameSource:
    """Answers requests for the planes of one frame, as an encoder does."""

    def __init__(self, planes: dict[int, Bits], family: str) -> None:
        self._planes = planes
        self._encoders = slepian_wolf.parity_encoders(family, SEED)
        self._parity: dict[tuple[int, int], Bits] = {}

    def answer(self, request: slepian_wolf.ParityRequest) -> Bits:
        """Return the bits that a request asks for."""
        crc_bits = REQUESTS.crc_bits
        if request.kind == "joint":
            checks = [slepian_wolf.crc(self._planes[plane], crc_bits) for plane in request.positions]
            return slepian_wolf.joint_check(np.stack(checks))[: request.count]
        bits = self._planes[request.plane]
        if request.kind == "crc":
            bits = slepian_wolf.crc(bits, crc_bits)
        elif request.kind == "parity":
            bits = self._parity_of(request.plane, request.code)
        if request.positions:
            return bits[list(request.positions)]
        return bits[request.start : request.start + request.count]

    def _parity_of(self, plane: int, code: int) -> Bits:
        if (plane, code) not in self._parity:
            words = self._planes[plane].astype(np.uint64)
            released = np.empty_like(words)
            self._encoders[code](words, released)
            self._parity[plane, code] = (released & np.uint64(1)).astype(np.uint8)
        return self._parity[plane, code]


@dataclass
class Judgement:
    """What a family of codes needed for recorded planes."""

    ideal_bits: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PLANE_CLASSES, 0.0))
    bits: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PLANE_CLASSES, 0.0))
    num_planes: int = 0
    num_wrong: int = 0
    num_requests: int = 0
    cpu_s: float = 0.0

    def ratio(self, *classes: str) -> float | None:
        """Return all bits over ideal code length."""
        ideal = sum(self.ideal_bits[name] for name in classes)
        return sum(self.bits[name] for name in classes) / ideal if ideal else None


def judge(recordings: list[Path], family: str) -> Judgement:
    """Code recorded planes, frame by frame."""
    judgement = Judgement()
    for path in recordings:
        with np.load(path) as arrays:
            places, bands, llr, bits = (arrays[name] for name in ("places", "bands", "llr", "bits"))
        decoder = slepian_wolf.plane_decoder(replace(REQUESTS, family=family), bits.shape[1], SEED)
        for frame in dict.fromkeys(places[:, 0].tolist()):
            rows = np.flatnonzero(places[:, 0] == frame).tolist()
            numbers = places[rows, 1].tolist()
            planes = dict(zip(numbers, bits[rows], strict=True))
            _judge_frame(judgement, decoder, planes, dict(zip(numbers, llr[rows], strict=True)),
                         dict(zip(numbers, bands[rows].tolist(), strict=True)), family)  # fmt: skip
    return judgement


def _judge_frame(
    judgement: Judgement,
    decoder: slepian_wolf.PlaneDecoder,
    planes: dict[int, Bits],
    llr: dict[int, NDArray[np.float32]],
    bands: dict[int, int],
    family: str,
) -> None:
    source = FrameSource(planes, family)
    started = time.process_time()
    results = {p: slepian_wolf.drive(decoder.decode(llr[p], (0, p)), source.answer) for p in planes}
    check = slepian_wolf.drive(decoder.check(0), source.answer)
    judgement.cpu_s += time.process_time() - started
    results |= check.corrected
    for plane, result in results.items():
        (name,) = (name for name, own in PLANE_CLASSES.items() if bands[plane] in own)
        judgement.ideal_bits[name] += result.ideal_bits
        judgement.bits[name] += result.parity_bits + result.crc_bits + check.crc_bits / len(planes)
        judgement.num_requests += result.num_requests
        judgement.num_wrong += not np.array_equal(result.bits, planes[plane])
    judgement.num_requests += check.num_requests
    judgement.num_planes += len(planes)


def _print_priors(streams: list[Path]) -> None:
    for stream in streams:
        lengths = measure_priors(stream)
        alone, learned = (sum(total[which] for total in lengths.values()) for which in (0, 1))
        classes = "  ".join(f"{name} {after / before:.3f}" for name, (before, after) in lengths.items())
        print(f"{stream.stem}: {learned / alone:.3f} of {alone:.0f} ideal bits; {classes}", flush=True)


def main() -> None:
    """Run the command that this module's first lines describe."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record")
    recording.add_argument("stream", type=Path)
    recording.add_argument("output", type=Path)
    judging = commands.add_parser("judge")
    judging.add_argument("family", choices=TURBO_FAMILIES)
    judging.add_argument("recordings", type=Path, nargs="+")
    measuring = commands.add_parser("priors")
    measuring.add_argument("streams", type=Path, nargs="+")
    arguments = parser.parse_args()
    if arguments.command == "priors":
        _print_priors(arguments.streams)
        return
    if arguments.command == "record":
        print(f"{record(arguments.stream, arguments.output)} planes")
        return
    found = judge(arguments.recordings, arguments.family)
    for name in PLANE_CLASSES:
        ratio = found.ratio(name)
        print(f"{name:9} {'-' if ratio is None else f'{ratio:.3f}'}  {found.ideal_bits[name]:.0f} ideal bits")
    print(f"all       {found.ratio(*PLANE_CLASSES):.3f}")
    each = found.num_planes
    print(f"{each} planes, {found.num_wrong} wrong; per plane {found.num_requests / each:.1f} requests,"
          f" {1e3 * found.cpu_s / each:.1f} ms")  # fmt: skip


if __name__ == "__main__":
    main()
