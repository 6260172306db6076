"""Mixtures of contexts: a plain twin, what they learn, and that both ends agree."""

import numpy as np
import pytest

from dvc.entropy import RangeCoder
from dvc.entropy.mixing import LEARNING_RATE, code_mixed, logistic_tables, mixed_probability, new_mixture


@pytest.mark.nojit
@pytest.mark.parametrize("third", [2, -1])
def test_probabilities_and_weights_are_those_of_a_plain_twin(third):
    mixture = new_mixture(3, 1, 0.4)
    odds, weights = np.full(3, 0.5), np.full(3, 0.4)
    used = [0, 1, 2] if third >= 0 else [0, 1]
    coder, rng = RangeCoder.writer(), np.random.default_rng(0)
    for count in range(200):
        stretched = np.log(odds / (1 - odds))
        wanted = 1 / (1 + np.exp(-np.sum((weights * stretched)[used])))
        found = mixed_probability(mixture, 0, 1, third, 0)
        assert found == pytest.approx(wanted, abs=0.01)
        decision = int(rng.random() < 0.8)
        code_mixed(coder.room_for(1), mixture, 0, 1, third, 0, decision)
        weights[used] += LEARNING_RATE * (decision - wanted) * stretched[used]
        odds[used] += (decision - odds[used]) / (count + 1.6)
    np.testing.assert_allclose(mixture.weights[0][used], weights[used], atol=0.02)
    np.testing.assert_allclose(mixture.contexts[used, 0], odds[used], atol=1e-12)
    if third < 0:
        assert tuple(mixture.contexts[2]) == (0.5, 0.0)


def test_what_was_written_is_read_and_takes_about_its_entropy():
    decisions = (np.random.default_rng(1).random(4000) < 0.05).astype(int)
    coded = []
    coder = RangeCoder.writer()
    for source in (decisions, np.zeros_like(decisions)):
        mixture = new_mixture(6, 2, 0.4)
        coded.append(
            [
                code_mixed(coder.room_for(1), mixture, k % 2, 2 + k % 3, 5, k % 2, int(one))
                for k, one in enumerate(source)
            ]
        )
        if source is decisions:
            data = coder.to_bytes()
            coder = RangeCoder.reader(data)
    np.testing.assert_array_equal(coded[0], decisions)
    np.testing.assert_array_equal(coded[1], decisions)
    share = decisions.mean()
    entropy = -share * np.log2(share) - (1 - share) * np.log2(1 - share)
    assert 8 * len(data) < 1.1 * 4000 * entropy


def test_tables_are_inverse_to_each_other():
    stretch, squash, rates = logistic_tables()
    back = squash[((stretch + 12) * (4096 / 24)).astype(int).clip(0, 4095)]
    np.testing.assert_allclose(back, (np.arange(4096) + 0.5) / 4096, atol=0.005)
    assert (np.diff(rates[:256]) < 0).all()
