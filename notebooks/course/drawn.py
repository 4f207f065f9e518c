"""Arguments of answers, drawn at random: general values, in which a mistake shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose

Bools = NDArray[np.bool_]


def pose(rng: np.random.Generator) -> Pose:
    """A pose within some metres of the origin."""
    x, y = rng.uniform(-4.0, 4.0, 2)
    return Pose(x, y, rng.uniform(-3.0, 3.0))


def cov(rng: np.random.Generator, size: int, scale: float = 0.3) -> Array:
    """(size, size) covariance with correlations."""
    root = scale * rng.standard_normal((size, size + 2))
    return np.asarray(root @ root.T)


def points(rng: np.random.Generator, count: int, reach_m: float = 5.0) -> Array:
    """(count, 2) points about the origin."""
    return rng.uniform(-reach_m, reach_m, (count, 2))


def mask(rng: np.random.Generator, share: float, shape: tuple[int, int] = (9, 13)) -> Bools:
    """A mask with this share of true cells."""
    return np.asarray(rng.random(shape) < share)
