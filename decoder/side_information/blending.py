"""Blending of what a model of the scene predicts with what block motion does, each where it is consistent."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from decoder.side_information.protocol import Prediction
from decoder.side_information.synthesis import Interpolation

Floats = NDArray[np.float64]

CONSISTENCY_WINDOW = 9
"""Side of the neighbourhood in which references are compared, in pixels."""
USUAL_DISAGREEMENT = 2.0
"""Squared difference from the scene that block motion may have, in units of its own squared error."""


def neighbourhood(plane: Floats) -> Floats:
    """Average a plane over the neighbourhood in which references are compared.

    Parameters
    ----------
    plane : ndarray of shape (H, W), float64
        Any plane.

    Returns
    -------
    ndarray of shape (H, W), float64
        Means.
    """
    mean: Floats = uniform_filter(plane, CONSISTENCY_WINDOW, mode="nearest")
    return mean


def inconsistency(flat: Prediction) -> Floats:
    """Measure how far the references of a prediction by block motion are from each other.

    Parameters
    ----------
    flat : Prediction
        By block motion.

    Returns
    -------
    ndarray of shape (H, W), float64
        Mean absolute difference in the neighbourhood of each pixel, and one level for noise.
    """
    found: Floats = neighbourhood(np.abs(flat.compensated[0] - flat.compensated[1])) + 1.0
    return found


def scene_share(
    flat: Prediction, rendered: Interpolation, trust: float = 1.0, bound: float = 1.0, doubt: float = 0.0
) -> Floats:
    """Weigh the scene's prediction against that of block motion, pixel by pixel.

    Parameters
    ----------
    flat : Prediction
        By block motion.
    rendered : Interpolation
        From the scene.
    trust : float, optional
        How much larger the scene's expected error may be than what block motion finds, for equal shares.
    bound : float, optional
        Largest share of the scene, above 0 and at most 1.
    doubt : float, optional
        How much block motion is doubted where it is far from the scene, although its references agree: part
        of the squared difference beyond the usual that is added to its squared error.

    Returns
    -------
    ndarray of shape (H, W), float64
        From 0 to `bound`: less where the geometry expects a large error, as on objects that move.
    """
    theirs, ours = inconsistency(flat), neighbourhood(rendered.expected_error)
    weight = theirs**2 * trust**2
    if doubt > 0.0:
        distance = neighbourhood((rendered.luma - flat.luma) ** 2)
        weight = weight + doubt * np.maximum(distance - USUAL_DISAGREEMENT * weight, 0.0)
    least = np.sqrt(weight * (1.0 / bound - 1.0))
    share: Floats = weight / (weight + np.maximum(ours, least) ** 2)
    return share


def shared(share: Floats, rendered: Interpolation, flat: Prediction) -> tuple[Floats, ...]:
    """Blend the compensated references of the scene with those of block motion.

    Parameters
    ----------
    share : ndarray of shape (H, W), float64
        Of the scene.
    rendered : Interpolation
        From the scene.
    flat : Prediction
        By block motion.

    Returns
    -------
    tuple of ndarray of shape (H, W), float64
        One for each reference.
    """
    return tuple(
        share * bounded(ours, rendered) + (1.0 - share) * theirs
        for ours, theirs in zip(rendered.compensated, flat.compensated, strict=True)
    )


def bounded(compensated: Floats, rendered: Interpolation) -> Floats:
    """Limit how far a reference is from the prediction: where it does not see a point, it says nothing.

    Parameters
    ----------
    compensated : ndarray of shape (H, W), float64
        Of one reference.
    rendered : Interpolation
        The prediction.

    Returns
    -------
    ndarray of shape (H, W), float64
        At most twice the expected error from the prediction.
    """
    limit = 2.0 * rendered.expected_error
    limited: Floats = rendered.luma + np.clip(compensated - rendered.luma, -limit, limit)
    return limited
