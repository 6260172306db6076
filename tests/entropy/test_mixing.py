"""Mixtures of contexts: a plain twin, what they learn, and that both ends agree."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc._jit import python_twin
from dvc.entropy import RangeCoder, code_adaptive, code_exp_golomb, context_counts
from dvc.entropy.binarisation import MAX_DECISIONS, NUM_EXPONENTS
from dvc.entropy.mixing import (
    LEARNING_RATE,
    Counts,
    code_mixed,
    logistic_tables,
    mixed_probability,
    new_mixture,
)
from dvc.errors import BitstreamError
from tests.reference import entropy as reference


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


LARGEST = 2**25 - 2
ZERO, SIGN, EXPONENTS, MANTISSAS = 0, 1, 2, 2 + NUM_EXPONENTS
NUM_CONTEXTS = MANTISSAS + NUM_EXPONENTS
NUMBERS = st.one_of(
    st.integers(-30, 30), st.integers(-LARGEST, LARGEST), st.sampled_from([LARGEST, -LARGEST])
)


def fresh(percent: int = 30) -> Counts:
    return context_counts([percent] * NUM_CONTEXTS)


def coded(coder: RangeCoder, counts: Counts, numbers: list[int], twin: bool = False) -> list[int]:
    code = python_twin(code_exp_golomb) if twin else code_exp_golomb
    state = coder.room_for(len(numbers) * MAX_DECISIONS)
    return [code(state, counts, ZERO, SIGN, EXPONENTS, MANTISSAS, number) for number in numbers]


@pytest.mark.nojit
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 1)), max_size=150), st.integers(1, 99))
def test_contexts_count_as_documented(decisions: list[tuple[int, int]], percent: int) -> None:
    counts, contexts = context_counts([percent] * 3), [reference.Context(percent) for _ in range(3)]
    writer, parts = RangeCoder.writer(), []
    for k, decision in decisions:
        assert code_adaptive(writer.room_for(1), counts, k, decision) == decision
        parts.append(reference.of_decision(float(contexts[k].probability()), decision))
        contexts[k].see(decision)
        assert counts.tolist() == [[context.zeros, context.ones] for context in contexts]
    assert writer.to_bytes() == reference.as_bytes(parts)
    reader, counts = RangeCoder.reader(writer.to_bytes()), context_counts([percent] * 3)
    assert [code_adaptive(reader.room_for(1), counts, k, 0) for k, _ in decisions] == [
        d for _, d in decisions
    ]


@pytest.mark.nojit
@given(st.lists(NUMBERS, max_size=20), st.booleans())
def test_numbers_come_back(numbers: list[int], twin: bool) -> None:
    """Each decision is in its context, with the probability of the twin; both ends have counted the same."""
    contexts, parts = [reference.Context(30) for _ in range(NUM_CONTEXTS)], []
    for number in numbers:
        for k, decision in reference.exp_golomb(number, ZERO, SIGN, EXPONENTS, MANTISSAS):
            parts.append(reference.of_decision(0.5 if k < 0 else float(contexts[k].probability()), decision))
            if k >= 0:
                contexts[k].see(decision)
    writer, written = RangeCoder.writer(), fresh()
    assert coded(writer, written, numbers, twin) == numbers
    assert writer.to_bytes() == reference.as_bytes(parts)
    reader, read = RangeCoder.reader(writer.to_bytes()), fresh()
    assert coded(reader, read, [0] * len(numbers), not twin) == numbers
    reader.check()
    assert np.array_equal(written, read)


@given(st.binary(max_size=60), st.integers(1, 30))
@settings(max_examples=200)
def test_any_bytes_are_numbers_or_refused(data: bytes, count: int) -> None:
    reader = RangeCoder.reader(data)
    numbers = coded(reader, fresh(90), [0] * count)
    try:
        reader.check()
    except BitstreamError:
        return
    writer = RangeCoder.writer()
    assert coded(writer, fresh(90), numbers) == numbers
    assert coded(RangeCoder.reader(writer.to_bytes()), fresh(90), [0] * count) == numbers


def test_exponents_without_end_are_refused() -> None:
    reader = RangeCoder.reader(b"\xff\xff\xff\x00" * 20)
    coded(reader, fresh(99), [0] * 5)
    with pytest.raises(BitstreamError, match="damaged"):
        reader.check()


@pytest.mark.parametrize("number", [LARGEST + 1, -LARGEST - 1])
def test_numbers_that_are_too_large_have_no_bytes(number: int) -> None:
    writer = RangeCoder.writer()
    coded(writer, fresh(), [number])
    with pytest.raises(AssertionError, match="room"):
        writer.to_bytes()


def test_adaptation_comes_near_the_entropy() -> None:
    rng = np.random.default_rng(2)
    numbers = np.rint(rng.laplace(scale=1.5, size=6000)).astype(int)
    writer = RangeCoder.writer()
    coded(writer, fresh(), numbers.tolist())
    shares = np.unique(numbers, return_counts=True)[1] / numbers.size
    entropy_bits = -numbers.size * (shares * np.log2(shares)).sum()
    assert entropy_bits < 8 * len(writer.to_bytes()) < 1.05 * entropy_bits
