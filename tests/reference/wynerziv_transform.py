"""Plain twin of the 4x4 transform: one matrix product per block, from the definition in [Malvar2003]."""

import numpy as np
from numpy.typing import NDArray

CORE = np.array([[1, 1, 1, 1], [2, 1, -1, -2], [1, -1, -1, 1], [1, -2, 2, -1]])
BASIS = CORE / np.sqrt((CORE**2).sum(axis=1, keepdims=True))
"""Rows are the orthonormal basis vectors."""
ZIGZAG_RANK = np.array([[0, 1, 5, 6], [2, 4, 7, 12], [3, 8, 11, 13], [9, 10, 14, 15]])
"""Position of each coefficient in zigzag order, as H.264 draws it."""


def forward(luma: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the bands of a frame whose sides are multiples of 4, shape (16, rows, columns)."""
    rows, columns = luma.shape[0] // 4, luma.shape[1] // 4
    bands = np.empty((16, rows, columns))
    for i in range(rows):
        for j in range(columns):
            block = luma[4 * i : 4 * i + 4, 4 * j : 4 * j + 4].astype(np.float64)
            coefficients = BASIS @ block @ BASIS.T
            for y in range(4):
                for x in range(4):
                    bands[ZIGZAG_RANK[y, x], i, j] = coefficients[y, x]
    return bands


def inverse(bands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the frame of such bands."""
    rows, columns = bands.shape[1:]
    luma = np.empty((4 * rows, 4 * columns))
    for i in range(rows):
        for j in range(columns):
            coefficients = np.array([[bands[ZIGZAG_RANK[y, x], i, j] for x in range(4)] for y in range(4)])
            luma[4 * i : 4 * i + 4, 4 * j : 4 * j + 4] = BASIS.T @ coefficients @ BASIS
    return luma
