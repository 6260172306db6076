"""What P-type frames cost, fitted."""

import numpy as np
import pytest

from benchmarks.searches.p_type_shares import Cost, fit
from encoder.intra_decision import FieldOfMotion, p_type_share


def test_the_rule_is_found_in_what_it_says() -> None:
    """Weights of costs that follow the rule are those of the rule."""
    rng, found = np.random.default_rng(3), []
    for number in range(40):
        field = FieldOfMotion(rng.uniform(0, 30), rng.uniform(0, 4), rng.uniform(0, 0.3))
        found.append(Cost("ab"[number % 3 == 0], 352, field, p_type_share(field, 352)))
    share, motion, parallax, loss = fit(found)
    field = FieldOfMotion(7.0, 2.0, 0.1)
    assert share + motion * 7 / 352 + parallax * 2 + loss * 0.1 == pytest.approx(p_type_share(field, 352))
    assert motion == pytest.approx(1.5)


def test_no_weight_is_below_zero() -> None:
    """Costs that fall where motion grows say nothing of motion."""
    found = [
        Cost("a", 100, FieldOfMotion(motion, 0.0, 0.0), 1.0 - motion / 100) for motion in (0.0, 10.0, 20.0)
    ]
    assert fit(found)[1] == 0.0
