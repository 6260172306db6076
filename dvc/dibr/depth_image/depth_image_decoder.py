"""The decoder of depth maps and of pictures with depth maps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.depth_image.depth_image_stream import DepthImageStream, PlaneCode
from dvc.dibr.depth_image.depth_scale import Plane
from dvc.dibr.view_rendering import PictureAndDisparity
from dvc.errors import ConfigError
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import Viewpoint
from dvc.images import chain_code, picture_codec
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_masks import Mask, border
from dvc.images.picture_codec import DecodedPicture

ORIGIN = LatticePosition(0.0, 0.0)
"""Where the picture is taken to be."""


@dataclass(frozen=True, eq=False)
class DecodedDepthImage:
    """A decoded stream."""

    stream: DepthImageStream  # what was decoded
    depth: Plane  # the map, in its own numbers; (H, W)
    picture: NDArray[np.uint8] | None  # gray, or red, green and blue; (H, W) or (H, W, 3)
    edges: EdgeMaps  # of the full resolution
    resolution: int  # how many times map and picture are halved
    mask: Mask | None = None  # where there is anything; None: everywhere; (h, w)

    @property
    def disparity(self) -> Plane:
        """Disparity, in pixels of the map per unit of m and n."""
        return self.stream.scale.disparity(self.depth) / 2.0**self.resolution

    @property
    def pairs(self) -> tuple[PictureAndDisparity, ...]:
        """The picture with its disparities; none without a picture."""
        if self.picture is None:
            return ()
        return (PictureAndDisparity(self.picture, self.disparity, ORIGIN),)

    @property
    def viewpoints(self) -> tuple[Viewpoint, ...]:
        """The viewpoint of the picture."""
        return (ORIGIN,)

    @property
    def step(self) -> float:
        """Distance of the disparities that are distinguished: all are."""
        return 0.0

    @property
    def damage(self) -> str | None:
        """What is missing of the stream."""
        return self.stream.damage


def decode(stream: DepthImageStream, resolution: int = 0) -> DecodedDepthImage:
    """Decode a stream.

    Parameters
    ----------
    stream : DepthImageStream
        As it was read.
    resolution : int, optional
        How many times map and picture are halved.

    Returns
    -------
    DecodedDepthImage
        Map and picture.

    Raises
    ------
    BitstreamError
        If the stream cannot have been written.
    ConfigError
        If there are not so many resolutions.
    """
    num_levels = stream.depth.header.num_levels
    if not 0 <= resolution <= num_levels:
        raise ConfigError(f"resolution {resolution}: 0 to {num_levels} are accepted")
    edges, mask = decode_edges_and_mask(stream)
    picture = None
    if stream.picture:  # first, as it takes more memory
        chosen = picture_edges(edges, mask, stream.picture_edges)
        picture = decode_plane(stream.picture, chosen, stream.shape, resolution, mask).picture()
    levels = decode_plane(stream.depth, edges, stream.shape, resolution, mask).planes[0]
    kept = None if mask is None else mask[:: 2**resolution, :: 2**resolution]
    return DecodedDepthImage(stream, stream.scale.depth(levels), picture, edges, resolution, kept)


def picture_edges(edges: EdgeMaps | None, mask: Mask | None, shared: bool) -> EdgeMaps | None:
    """Return where the transform of a picture stops."""
    if shared:
        return edges
    return None if mask is None else border(mask)


def decode_edges(stream: DepthImageStream) -> EdgeMaps:
    """Return the edges of a stream."""
    return decode_edges_and_mask(stream)[0]


def decode_edges_and_mask(stream: DepthImageStream) -> tuple[EdgeMaps, Mask | None]:
    """Return the edges of a stream, and its mask."""
    if stream.masked:
        return chain_code.decode_masked(stream.edges, stream.shape, stream.edge_code)
    if not stream.edges:
        return EdgeMaps.none(stream.shape), None
    return chain_code.decode(stream.edges, stream.shape, stream.edge_code), None


def decode_plane(
    code: PlaneCode,
    edges: EdgeMaps | None,
    shape: tuple[int, int],
    resolution: int = 0,
    mask: Mask | None = None,
) -> DecodedPicture:
    """Decode a map, as levels, or a picture."""
    if mask is None and edges is not None and not edges.count():
        edges = None
    return picture_codec.decode(code.header, code.data, shape, resolution, edges, code.order, mask)
