"""Parameters of a reconstruction: one set for all scenes, chosen on several."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dvc.geometry.label_inference import Inference
    from dvc.geometry.matching_costs import Window

COST_NAMES = "census", "squared"
INFERENCE_NAMES = "belief-propagation", "semi-global"
OCCLUSION_NAMES = "explicit", "implicit", "none"
UNDEFINED_COST = 0.5
"""Cost of an undefined voxel, as a share of the highest: above that of most good matches."""
SLOPE, SMALL_JUMP = 0.2, 0.3
"""Cost of a change by a pixel of parallax between neighbours, for messages and for scanlines."""


def max_jump(fineness: float) -> int:
    """Return the largest change of label between neighbouring pixels on a surface.

    Parameters
    ----------
    fineness : float
        Labels per pixel of parallax.

    Returns
    -------
    int
        Two pixels; more is a discontinuity.
    """
    return round(2.0 * fineness)


def tolerance(fineness: float) -> int:
    """Return the largest difference of label between two cameras on one surface.

    Parameters
    ----------
    fineness : float
        Labels per pixel of parallax.

    Returns
    -------
    int
        Half a pixel, and one label at least.
    """
    return max(1, round(0.5 * fineness))


@dataclass(frozen=True)
class StereoSettings:
    """Settings of a reconstruction.

    Attributes
    ----------
    cost : str
        Matching cost, one of `COST_NAMES`; costs of squared differences are not aggregated.
    inference : str or Inference
        Method, one of `INFERENCE_NAMES` or an object.
    occlusion : str
        Treatment of hidden points: explicit visibility from the surfaces (2.19) of the previous iteration;
        implicit, by the better one of opposite neighbours (2.18); or none, with equal weights of all.
    max_iterations : int
        Largest number of iterations; the first one has no visibility. Large views begin with this number at
        their smallest size, and take two more iterations for each larger size.
    min_change : float
        Share of pixels with a change of more than one label, below which the iterations end.
    geometric_weight, geometric_limit : float
        lambda_g of (2.13), in units of costs, and tau_1 of (2.16), in labels.
    sub_pixel : bool
        Whether disparities lie between those of the labels.
    agreement : str
        Rule for support of a surface by another camera (2.15): ``near`` labels, if the camera sees the point,
        in large regions; or ``exact`` ones.
    edge_strength : float
        Smoothness between pixels of different colours, relative to 1 between pixels of one colour.
    undefined_cost : float
        Cost of voxels without a visible neighbour (2.20), as a share of the highest.
    filling : str
        Surface without support by another camera: supported surfaces are ``continued``, and cameras correct
        each other; or labels stay as ``inferred``.
    exposures : bool
        Whether views are first brought to the exposure of the reference, by surfaces that both see.
    """

    cost: str = "census"
    inference: "str | Inference" = "belief-propagation"
    occlusion: str = "explicit"
    max_iterations: int = 3
    min_change: float = 0.002
    geometric_weight: float = 0.0
    geometric_limit: float = 3.0
    sub_pixel: bool = False
    agreement: str = "near"
    edge_strength: float = 0.05
    undefined_cost: float = UNDEFINED_COST
    filling: str = "continued"
    exposures: bool = True

    def takes_smaller(self, iteration: int) -> bool:
        """Return whether the smaller cost of opposite neighbours counts (2.18), or the mean of both."""
        if self.occlusion == "explicit":
            return iteration == 0 or self.cost == "squared"
        return self.occlusion == "implicit"

    def windows(self, iteration: int) -> "tuple[Window, ...]":
        """Return the windows of aggregation; none for costs of single pixels."""
        from dvc.geometry.matching_costs import Window

        if self.cost == "squared":
            return ()
        # wide windows for weak texture; narrow ones for steep surfaces, without a base surface yet
        wide, narrow = Window(80, 34, 2, far_limit=12), Window(9, 5, 1)
        return (wide, narrow) if iteration == 0 else (wide,)

    def inference_method(self, iteration: int, fineness: float) -> "Inference":
        """Return the method that infers labels; scanlines infer the first base surface."""
        from dvc.geometry.label_inference import BeliefPropagation, SemiGlobal

        if not isinstance(self.inference, str):
            return self.inference
        scanlines = self.inference == "semi-global" or (iteration == 0 and self.cost != "squared")
        if scanlines:
            return SemiGlobal(small_jump=SMALL_JUMP / fineness)
        steps = SLOPE / fineness, max_jump(fineness)
        return BeliefPropagation(steps[0], max_jump=steps[1], edge_strength=self.edge_strength)
