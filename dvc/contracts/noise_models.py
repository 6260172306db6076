"""What every model of correlation noise must do."""

import numpy as np
import pytest

from dvc.wynerziv.noise import MIN_SCALE, NoiseModel


class NoiseModelContract:
    """Tests of a model; a class derived from this one says which, by the fixture `model`."""

    def test_scales_follow_the_residual(self, model: NoiseModel) -> None:
        """On a Laplacian residual it finds about its scale, and never less on a larger residual."""
        residual = np.random.default_rng(3).laplace(0.0, 5.0, (16, 30, 40))
        scale = model(residual.copy())
        assert scale.shape == residual.shape
        assert scale.dtype == np.float64
        assert scale.mean() == pytest.approx(5.0, rel=0.35)
        assert (model(2.0 * residual) >= scale).all()

    def test_identical_references_give_the_smallest_scale(self, model: NoiseModel) -> None:
        """No residual leaves the floor that rounding makes."""
        np.testing.assert_allclose(model(np.zeros((16, 2, 3))), MIN_SCALE)

    def test_one_block_is_enough(self, model: NoiseModel) -> None:
        """Any number of blocks gives finite scales, of at least the floor; the residual is left as it was."""
        for shape in ((16, 1, 1), (16, 1, 7), (16, 5, 1)):
            residual = np.random.default_rng(1).normal(0.0, 9.0, shape)
            kept = residual.copy()
            scale = model(residual)
            assert np.isfinite(scale).all()
            assert (scale >= MIN_SCALE).all()
            np.testing.assert_array_equal(residual, kept)

    def test_scales_are_deterministic(self, model: NoiseModel) -> None:
        """Decoders agree bit by bit."""
        residual = np.random.default_rng(2).normal(0.0, 4.0, (16, 6, 6))
        assert model(residual).tobytes() == model(residual.copy()).tobytes()
