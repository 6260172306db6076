"""What distortions are found by."""

import numpy as np

from dvc.dibr.disparity.distortion import _adjugates


def test_adjugates_are_inverses_but_for_positive_scales() -> None:
    """Whatever the sign of the determinant; where there is no inverse they are nothing."""
    rng = np.random.default_rng(0)
    matrices = rng.normal(size=(20, 3, 3))
    determinants = np.linalg.det(matrices)
    assert (determinants > 0).any()
    assert (determinants < 0).any()
    expected = np.linalg.inv(matrices) * np.abs(determinants)[:, None, None]
    np.testing.assert_allclose(_adjugates(matrices), expected, atol=1e-12)
    assert not _adjugates(np.ones((1, 3, 3))).any()
