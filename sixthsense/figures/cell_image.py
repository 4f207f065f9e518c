"""The grid of a film's frame as an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array

_MOST_CELLS = 800  # on a side; a frame has no more pixels to show them with


class CellImage:
    """The grid within a rectangle as an image, at a coarser resolution if it has more cells than the film pixels."""

    def __init__(self, low: Array, high: Array, cell_m: float) -> None:
        self._first = np.floor(low[::-1] / cell_m).astype(np.int64)  # row, col
        self._cell_m = cell_m
        past = np.ceil(high[::-1] / cell_m).astype(np.int64)
        self._step = max(1, -(-int((past - self._first).max()) // _MOST_CELLS))
        self._shape = tuple((-(-(past - self._first) // self._step)).tolist())

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top, metres."""
        row, col = self._first
        side = self._step * self._cell_m
        height, width = self._shape
        return (
            col * self._cell_m,
            col * self._cell_m + width * side,
            row * self._cell_m,
            row * self._cell_m + height * side,
        )

    def empty(self) -> NDArray[np.uint8]:
        """An image of unseen cells."""
        return np.zeros(self._shape, dtype=np.uint8)

    def shades(self, occupancy: NDArray[np.int8], origin: tuple[float, float]) -> NDArray[np.uint8]:
        """0 unseen, 1 seen, 2 obstacle, of an (H, W) occupancy grid with its lower left corner at `origin`, metres."""
        image = self.empty()
        rows, cols = np.nonzero(occupancy >= 0)
        shades = np.where(occupancy[rows, cols] == 100, 2, 1)
        first = round(origin[1] / self._cell_m), round(origin[0] / self._cell_m)
        at = [(cells + first[k] - self._first[k]) // self._step for k, cells in enumerate((rows, cols))]
        inside = (at[0] >= 0) & (at[0] < image.shape[0]) & (at[1] >= 0) & (at[1] < image.shape[1])
        np.maximum.at(image, (at[0][inside], at[1][inside]), shades[inside].astype(np.uint8))
        return image
