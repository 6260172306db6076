"""First weights of priors, fitted to decoded planes."""

import numpy as np
import pytest

from benchmarks.searches.priors import code_length, fitted, met
from dvc.wynerziv.priors import LearnedPriors
from tests.golden_streams import FOLDER


def test_weights_are_those_that_bits_were_drawn_by() -> None:
    """Clips of any length have equal weight; a term without information gets no weight."""
    rng = np.random.default_rng(1)
    clips = []
    for count in (20_000, 60_000):
        terms = rng.normal(0.0, 1.0, (3, count))
        is_zero = rng.random(count) < 1.0 / (1.0 + np.exp(-(1.5 * terms[0] - 0.5 * terms[1])))
        clips.append((terms, terms[0], np.where(is_zero, 0, 1).astype(np.uint8)))
    weights = fitted(clips)
    assert weights == pytest.approx([1.5, -0.5, 0.0], abs=0.05)
    terms, llr, bits = clips[0]
    assert code_length(weights @ terms, bits) < 0.98 * code_length(llr, bits)


def test_planes_are_those_that_decoding_has_met() -> None:
    usual = LearnedPriors.learn
    planes = met((FOLDER / "2d-predicted-buffered.dvc").read_bytes())
    assert LearnedPriors.learn is usual
    terms, llr, bits = planes[1].together()
    assert terms.shape[1] == llr.size == bits.size > 100
    assert np.corrcoef(terms[0], llr)[0, 1] > 0.8
