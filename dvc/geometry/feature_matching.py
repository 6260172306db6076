"""Points that two pictures share: SIFT features, matched both ways."""

from typing import Any
from weakref import WeakKeyDictionary

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
MAX_FEATURES = 8000
LEAST_CONTRAST = 0.01
"""A quarter of OpenCV's: walls and floors have points, too, and matches are few where these are left out."""
RATIO = 0.8
"""Between the distances to the nearest and the second nearest descriptor, at most."""


class Features:
    """SIFT features of a picture."""

    def __init__(self, image: NDArray[np.uint8]) -> None:
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        detector = cv2.SIFT.create(MAX_FEATURES, contrastThreshold=LEAST_CONTRAST)
        keypoints, descriptors = detector.detectAndCompute(grey, None)
        self.points: Floats = np.array([point.pt for point in keypoints], np.float64).reshape(-1, 2)
        self._matches = WeakKeyDictionary[Features, tuple[Floats, Floats]]()  # known already
        self._descriptors = np.zeros((0, 128), np.float32) if descriptors is None else _rooted(descriptors)

    def match(self, other: "Features") -> tuple[Floats, Floats]:
        """Match with another picture."""
        if other not in self._matches:
            self._matches[other] = self._matched(other)
        return self._matches[other]

    def _matched(self, other: "Features") -> tuple[Floats, Floats]:
        forward, backward = self._nearest(other), other._nearest(self)
        pairs = [(a, b) for a, b in forward.items() if backward.get(b) == a]
        index = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        return self.points[index[:, 0]], other.points[index[:, 1]]

    def _nearest(self, other: "Features") -> dict[int, int]:
        if min(len(self.points), len(other.points)) < 2:
            return {}
        found = cv2.BFMatcher(cv2.NORM_L2).knnMatch(self._descriptors, other._descriptors, 2)
        return {
            best.queryIdx: best.trainIdx for best, second in found if best.distance < RATIO * second.distance
        }


def _rooted(descriptors: NDArray[Any]) -> NDArray[np.float32]:
    """Return descriptors whose Euclidean distance is Hellinger's: large gradients count less (RootSIFT)."""
    shares = descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
    return np.asarray(np.sqrt(shares), np.float32)
