"""A transform of planes with all that it needs: wavelet, scales, and edges if it is to stop at them."""

from dataclasses import dataclass

from dvc.dibr.wavelets import lifting, shape_adaptive
from dvc.dibr.wavelets.edge_maps import EdgeMaps
from dvc.dibr.wavelets.lifting import WAVELETS, Plane, Pyramid
from dvc.dibr.wavelets.shape_adaptive import Mask


@dataclass(frozen=True)
class Transform:
    """How planes become pyramids of coefficients, and back.

    Attributes
    ----------
    num_levels : int
        How many times planes are split.
    wavelet : str
        One of `WAVELETS`.
    edges : EdgeMaps, optional
        Of planes of their shape; none for the standard transform.
    order : int
        Of the extrapolation at edges.
    mask : ndarray of shape (H, W), bool, optional
        Where there is anything, by default everywhere; its border is among the edges.
    """

    num_levels: int
    wavelet: str = "9/7"
    edges: EdgeMaps | None = None
    order: int = 0
    mask: Mask | None = None

    def analyse(self, plane: Plane) -> Pyramid:
        """Transform a plane; the inverse of `synthesise`.

        Parameters
        ----------
        plane : ndarray of shape (H, W), float64
            Samples.

        Returns
        -------
        Pyramid
            Its coefficients.
        """
        wavelet = WAVELETS[self.wavelet]
        if self.edges is None:
            return lifting.analyse(plane, self.num_levels, wavelet)
        return shape_adaptive.analyse(plane, self.edges, self.num_levels, self.order, wavelet, self.mask)

    def synthesise(self, pyramid: Pyramid) -> Plane:
        """Return the plane of coefficients.

        Parameters
        ----------
        pyramid : Pyramid
            Coefficients; without its finest details it gives the low band of that scale.

        Returns
        -------
        ndarray of shape (h, w), float64
            The plane.
        """
        wavelet = WAVELETS[self.wavelet]
        if self.edges is None:
            return lifting.synthesise(pyramid, wavelet)
        skipped = self.num_levels - len(pyramid.details)
        *_, edges = self.edges.pyramid(skipped + 1)
        mask = None if self.mask is None else self.mask[:: 2**skipped, :: 2**skipped]
        return shape_adaptive.synthesise(pyramid, edges, self.order, wavelet, mask)
