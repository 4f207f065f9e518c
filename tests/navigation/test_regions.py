"""Regions followed no further than needed are those that labels of the whole map say."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.navigation.regions import are_beside, frontier_cells, in_large_regions, spread

Mask = NDArray[np.bool_]


def scattered(seed: int, share: float, shape: tuple[int, int] = (23, 31)) -> Mask:
    return np.random.default_rng(seed).random(shape) < share


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("steps", [1, 2, 7])
def test_a_mask_spreads_as_by_dilations_within_another_one(seed: int, steps: int) -> None:
    allowed = scattered(seed, 0.7)
    mask = allowed & scattered(seed + 50, 0.05)
    expected = ndimage.binary_dilation(mask, iterations=steps, mask=allowed)
    assert np.array_equal(spread(mask, allowed, steps, (0, 0, 0, 0)), expected)
    mask[4:18, 6:29] |= allowed[4:18, 6:29]
    expected = ndimage.binary_dilation(mask, iterations=steps, mask=allowed)
    assert np.array_equal(spread(mask, allowed, steps, (4, 18, 6, 29)), expected)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("least", [1, 4, 15])
def test_regions_are_large_by_their_size_or_as_that_of_the_robot(seed: int, least: int) -> None:
    free = scattered(seed, 0.5)
    cells, here = np.argwhere(free), (11, 13)
    labels, count = ndimage.label(free)
    kept = np.bincount(labels.ravel(), minlength=count + 1) >= least
    kept[labels[here]] = True
    kept[0] = False
    assert np.array_equal(in_large_regions(free, cells, least, here), kept[labels][free])


@pytest.mark.parametrize("seed", range(5))
def test_cells_beside_a_mask_are_its_frontier(seed: int) -> None:
    mask, free = scattered(seed, 0.2), scattered(seed + 50, 0.5)
    assert np.array_equal(are_beside(mask, np.argwhere(free)), frontier_cells(free, mask)[free])
