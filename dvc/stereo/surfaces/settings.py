"""Parameters of a reconstruction: one set for all scenes, chosen on several."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dvc.geometry.volumes.aggregation import Window
    from dvc.geometry.volumes.inference import Inference

TUNING_PAIRS = (
    *("tsukuba", "venus", "teddy", "cones"),
    *("Adirondack_Q", "Baby1", "Bowling2", "Flowerpots", "Lampshade1"),
    *("Monopoly", "Playroom_Q", "Rocks1", "barn1", "sawtooth"),
)
TEST_PAIRS = "Aloe", "Cloth3", "Midd1", "Pipes_Q", "Recycle_Q", "Wood2", "bull"
"""Pairs of Middlebury that settings were chosen on, and others, which several trials were compared on."""
COST_NAMES = "census", "squared"
INFERENCE_NAMES = "belief-propagation", "semi-global"
OCCLUSION_NAMES = "explicit", "implicit", "none"
AGREEMENT_NAMES = "near", "exact"
FILLING_NAMES = "continued", "inferred"
UNDEFINED_COST = 0.5
"""Cost of a voxel of which nothing is known, as a share of the highest: above that of most good matches."""
SLOPE, SMALL_JUMP = 0.2, 0.3
"""Cost of a change by a pixel of parallax from one pixel to the next, for messages and for scanlines."""


def max_jump(fineness: float) -> int:
    """Return by how many labels a surface may change from pixel to pixel.

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
    """Return by how many labels two cameras may differ on one surface.

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
    """How surfaces are found.

    Attributes
    ----------
    cost : str
        Matching cost, of `COST_NAMES`; costs of squared differences are not aggregated.
    inference : str or Inference
        Method, one of `INFERENCE_NAMES` or an object.
    occlusion : str
        What is done about hidden points: visibility is computed from surfaces (2.19), as soon as there are
        any; the better one of opposite neighbours counts (2.18); or nothing is done, all count alike.
    max_iterations : int
        Times that surfaces are found, at most; the first time nothing is known of visibility. Large views
        begin with their smallest size, for which this counts, and take two more for each larger one.
    min_change : float
        Share of pixels whose label changes by more than one, below which no further iteration follows.
    geometric_weight, geometric_limit : float
        lambda_g of (2.13), in units of costs, and tau_1 of (2.16), in labels.
    sub_pixel : bool
        Whether disparities lie between those of the labels.
    agreement : str
        When a camera supports the surface of another (2.15), of `AGREEMENT_NAMES`: its label is near, where
        it looks at all, and not in small regions only; or it is the same.
    edge_strength : float
        Smoothness between pixels of different colours, of 1 between those of one colour.
    undefined_cost : float
        Of voxels where no neighbour counts (2.20), as a share of the highest.
    filling : str
        What the surface is where no other camera supports it, of `FILLING_NAMES`: supported surfaces are
        continued, and cameras correct each other; or what was inferred.
    exposures : bool
        Whether views are first given the exposure of the reference, as far as what both see tells it.
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
        """Tell whether the smaller cost of opposite neighbours counts (2.18), or the mean of both.

        Parameters
        ----------
        iteration : int
            From 0.

        Returns
        -------
        bool
            Costs that are summed over regions do without it once visibility is known.
        """
        if self.occlusion == "explicit":
            return iteration == 0 or self.cost == "squared"
        return self.occlusion == "implicit"

    def windows(self, iteration: int) -> "tuple[Window, ...]":
        """Return what costs are summed over.

        Parameters
        ----------
        iteration : int
            From 0.

        Returns
        -------
        tuple of Window
            None for costs that are not aggregated.
        """
        from dvc.geometry.volumes.aggregation import Window

        if self.cost == "squared":
            return ()
        # wide ones for what has little texture; narrow ones for steep surfaces, before there is a base
        wide, narrow = Window(80, 34, 2, far_limit=12), Window(9, 5, 1)
        return (wide, narrow) if iteration == 0 else (wide,)

    def inference_method(self, iteration: int, fineness: float) -> "Inference":
        """Return the method that infers labels; scanlines find the first base surface.

        Parameters
        ----------
        iteration : int
            From 0.
        fineness : float
            Labels per pixel of parallax.

        Returns
        -------
        Inference
            The method.
        """
        from dvc.geometry.volumes.belief_propagation import BeliefPropagation
        from dvc.geometry.volumes.inference import SemiGlobal

        if not isinstance(self.inference, str):
            return self.inference
        scanlines = self.inference == "semi-global" or (iteration == 0 and self.cost != "squared")
        if scanlines:
            return SemiGlobal(small_jump=SMALL_JUMP / fineness)
        steps = SLOPE / fineness, max_jump(fineness)
        return BeliefPropagation(steps[0], max_jump=steps[1], edge_strength=self.edge_strength)
