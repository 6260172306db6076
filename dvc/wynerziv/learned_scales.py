"""Scales of the correlation noise, learned from what is believed of the numbers while they are decoded.

The scale that a prediction promises is often wrong by half. Whatever belief propagation has found out of the
numbers tells by how much the prediction is off: on the whole band, and around each coefficient, whose own
error is left out, so that no belief confirms itself.

References
----------
[Varodayan2008] D. Varodayan, D. Chen, M. Flierl, B. Girod, "Wyner-Ziv coding of video with unsupervised
motion vector learning", Signal Processing: Image Communication 23(5), 2008: the decoder of
syndromes is the expectation of an expectation maximisation.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from dvc.slepian_wolf.ldpc.belief_propagation import NumberPriors
from dvc.wynerziv.candidates import number_priors

Array = NDArray[np.float64]

_SIDE = 3
"""Of the neighbourhood, in coefficients."""
_LEAST = 1e-2


@dataclass(frozen=True, eq=False)
class LearnedBand:
    """What is believed of a band."""

    edges: Array  # borders of its bins, which are embedded: all of one width
    planes: int  # planes of the band, and how many of them are coded
    depth: int
    predicted: Array  # predicted coefficients
    promised: Array  # scales of the Laplacians before anything is known, positive
    scale: Array  # the same as learned so far

    def priors(self) -> NumberPriors:
        """Return where numbers are likely to be."""
        return number_priors(self.edges, self.planes, self.depth, self.predicted.ravel(), self.scale.ravel())

    def learn(self, priors: NumberPriors, believed: NDArray[np.float32]) -> Self:
        """Learn from what is believed of the numbers."""
        errors = self._expected_errors(priors, believed)
        around = (_SIDE**2 * uniform_filter(errors, _SIDE, mode="nearest") - errors) / (_SIDE**2 - 1)
        # Half of the logarithm of a scale is what the prediction promised, half the errors around.
        scale = np.sqrt(self.promised * np.maximum(around, _LEAST))
        scale *= float((errors / scale).mean())
        return replace(self, scale=np.maximum(scale, _LEAST))

    def _expected_errors(self, priors: NumberPriors, believed: NDArray[np.float32]) -> Array:
        """Return the expected magnitude of each coefficient minus its prediction."""
        from dvc.wynerziv import _kernels

        borders = np.ascontiguousarray(self.edges[:: 1 << (self.planes - self.depth)])
        errors = np.empty(self.predicted.size)
        _kernels.expected_errors(
            borders,
            priors.lowest,
            priors.counts,
            believed,
            self.predicted.ravel(),
            self.scale.ravel(),
            errors,
        )
        return errors.reshape(self.predicted.shape)
