"""A transform of planes with all that it needs: wavelet, scales, and edges if it is to stop at them."""

from dataclasses import dataclass

from dvc.imagecodec.wavelets import lifting, shape_adaptive
from dvc.imagecodec.wavelets.edge_maps import EdgeMaps
from dvc.imagecodec.wavelets.lifting import WAVELETS, Plane, Pyramid
from dvc.imagecodec.wavelets.shape_adaptive import Mask


@dataclass(frozen=True)
class Transform:
    """How planes become pyramids of coefficients, and back."""

    num_levels: int  # how many times planes are split
    wavelet: str = "9/7"  # one of `WAVELETS`
    edges: EdgeMaps | None = None  # of planes of their shape; none for the standard transform
    order: int = 0  # of the extrapolation at edges
    mask: Mask | None = None  # where there is anything, by default everywhere; its border is among the edges

    def analyse(self, plane: Plane) -> Pyramid:
        """Transform a plane; the inverse of `synthesise`."""
        wavelet = WAVELETS[self.wavelet]
        if self.edges is None:
            return lifting.analyse(plane, self.num_levels, wavelet)
        return shape_adaptive.analyse(plane, self.edges, self.num_levels, self.order, wavelet, self.mask)

    def synthesise(self, pyramid: Pyramid) -> Plane:
        """Return the plane of coefficients."""
        wavelet = WAVELETS[self.wavelet]
        if self.edges is None:
            return lifting.synthesise(pyramid, wavelet)
        skipped = self.num_levels - len(pyramid.details)
        *_, edges = self.edges.pyramid(skipped + 1)
        mask = None if self.mask is None else self.mask[:: 2**skipped, :: 2**skipped]
        return shape_adaptive.synthesise(pyramid, edges, self.order, wavelet, mask)
