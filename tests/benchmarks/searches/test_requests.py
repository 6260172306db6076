"""Runs of bits from real decoding, reconciled again."""

import numpy as np

from benchmarks.searches.requests import Run, recorded, row
from dvc.contracts.test_plane_coders import noisy
from dvc.slepian_wolf.cascade.cascade_coder import CascadeDecoder
from tests.golden_streams import FOLDER


def test_more_at_a_time_takes_fewer_requests() -> None:
    drawn = [noisy(np.random.default_rng(k), 1584, 0.03) for k in range(4)]
    runs = [Run(llr, None, bits) for bits, llr in drawn]
    few, many = (row(runs, percent).split() for percent in (0, 30))
    assert (few[0], many[0], few[11], many[11]) == ("0", "30", "4", "4")
    assert float(few[4]) < float(many[4])
    assert float(few[7]) > 2 * float(many[7])


def test_runs_are_those_that_decoding_has_met() -> None:
    usual = CascadeDecoder.decode
    runs = recorded([(FOLDER / "2d-qp-buffered.dvc").read_bytes()])
    assert CascadeDecoder.decode is usual
    right = [np.mean((run.llr < 0) == run.bits) for run in runs]
    assert len(runs) > 10
    assert np.mean(right) > 0.8
