"""Size of a request for bits of a run: bits and requests of runs from real decoding.

``python -m benchmarks.searches.requests [CLIP ...] [--percent 0 6 20] [--set RANGE_BIAS=0.2]`` decodes clips
once, records the prior of each run, and reconciles these runs again with each share of the unknown bits;
`--set` gives a constant of `dvc.slepian_wolf.cascade` another value. `WORTH_ASKING`, `RANGE_BIAS` and
`MORE_BITS` were chosen on box, stone, street, tree, cube and desk; `SWEEPS` and `CHANGE` on box, street and
desk, and tested on stone, tree, cube and river.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from benchmarks.stages import coded, decoded
from dvc.config import CascadeConfig
from dvc.slepian_wolf import CRC_BITS, NeighbourCoupling, ParityRequest, PlaneResult, crc, drive
from dvc.slepian_wolf.cascade import cascade_coder, posterior
from dvc.slepian_wolf.cascade.posterior import NUM_ORDERS, bit_order
from dvc.slepian_wolf.coupling import bounded_llr, ideal_bits

CLIPS = ("box", "stone", "street", "tree", "cube", "desk")
SEED = 0
Bits = NDArray[np.uint8]


class Run(NamedTuple):
    """A run of bits from real decoding."""

    llr: NDArray[np.floating]
    coupling: NeighbourCoupling | None
    bits: Bits


def recorded(streams: list[bytes]) -> list[Run]:
    """Return the runs of streams, by decoding them."""
    runs, decoder = list[Run](), cascade_coder.CascadeDecoder
    usual, usual_check = decoder.decode, decoder.check

    def recording(self, llr, position=(0, 0), coupling=None):  # type: ignore[no-untyped-def]
        result = yield from usual(self, llr, position, coupling)
        vars(self).setdefault("recorded", {})[position[1]] = Run(llr.copy(), coupling, result.bits)
        return result

    def recording_check(self, frame=0):  # type: ignore[no-untyped-def]
        result = yield from usual_check(self, frame)
        own = vars(self).pop("recorded", {})
        right = {number: other.bits for number, other in result.corrected.items()}
        runs.extend(run._replace(bits=right.get(number, run.bits)) for number, run in own.items())
        return result

    with mock.patch.multiple(decoder, decode=recording, check=recording_check):
        for stream in streams:
            decoded(stream)
    return runs


def answering(bits: Bits) -> Callable[[ParityRequest], Bits]:
    """Return a function that answers requests for a run."""
    orders = np.stack([bit_order(number, bits.size, SEED) for number in range(NUM_ORDERS)])
    parities = np.bitwise_xor.accumulate(bits[orders], axis=1).ravel()
    check = crc(bits, CRC_BITS)

    def answer(request: ParityRequest) -> Bits:
        if request.kind == "parity":
            answered: Bits = parities[request.code * bits.size + np.array(request.positions)]
            return answered
        return (check if request.kind == "crc" else bits)[request.start : request.start + request.count]

    return answer


def reconciled(runs: list[Run], settings: CascadeConfig) -> Iterator[tuple[Run, PlaneResult]]:
    """Decode runs, each by itself."""
    for run in runs:
        steps = cascade_coder.PlaneReconciliation(run.llr, settings, (0, 0), run.coupling)
        beliefs = posterior.RangePosterior(run.bits.size, SEED)
        yield run, drive(steps.decode(beliefs), answering(run.bits))


def row(runs: list[Run], percent: int) -> str:
    """Return a line for a share of the unknown bits."""
    started = time.process_time()
    found = list(reconciled(runs, CascadeConfig(percent)))
    spent_ms = 1e3 * (time.process_time() - started)
    paid = sum(result.parity_bits + result.crc_bits for _, result in found)
    llrs = (r.llr if r.coupling is None else r.coupling.llr_given(r.bits, causal=True) for r in runs)
    ideal = sum(ideal_bits(bounded_llr(llr), r.bits) for llr, r in zip(llrs, runs, strict=True))
    wrong = sum(not np.array_equal(run.bits, result.bits) for run, result in found)
    requests = sum(result.num_requests for _, result in found)
    count = len(found)
    return (
        f"{percent:4d} % {paid:9d} bits {paid / ideal:6.3f} of ideal {requests / count:6.2f} requests"
        f" {spent_ms / count:6.2f} ms {count:6d} runs, {wrong:3d} of them passed wrongly"
    )


def main() -> None:
    """Print a row for each share."""
    parser = argparse.ArgumentParser("python -m benchmarks.searches.requests", description=__doc__)
    parser.add_argument("clips", nargs="*", metavar="CLIP", default=CLIPS)
    parser.add_argument("--qp", type=int, nargs="+", default=[26, 34])
    parser.add_argument("--frames", type=int, default=9)
    parser.add_argument("--percent", type=int, nargs="+", default=[0, 4, 6, 8, 12, 20, 30])
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="of a constant")
    parser.add_argument("--out", type=Path, default=Path("out/stages"), help="folder of streams")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    runs = recorded(
        [coded(c, qp, arguments.frames, arguments.out) for c in arguments.clips for qp in arguments.qp]
    )
    for given in arguments.set:
        name, _, value = given.partition("=")
        (owner,) = (module for module in (cascade_coder, posterior) if name in vars(module))
        setattr(owner, name, type(getattr(owner, name))(value))
    for percent in arguments.percent:
        print(row(runs, percent), flush=True)


if __name__ == "__main__":
    main()
