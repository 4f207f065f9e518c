"""Checks of what a caller hands over: errors name the argument, what was expected and what was found."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sixthsense.config.section import shown
from sixthsense.core.geometry import Array, Pose


def as_array(name: str, value: ArrayLike, shape: tuple[int | str, ...], finite: bool = True) -> Array:
    """`value` as a float64 array of a shape, in which a letter stands for any length.

    Raises ValueError for anything but an array of numbers, for another shape and, with `finite`, for NaN and infinity.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected numbers of shape {_text(shape)}, got {shown(value)}") from None
    alike = len(array.shape) == len(shape) and all(
        isinstance(length, str) or length == found for length, found in zip(shape, array.shape, strict=True)
    )
    if not alike:
        raise ValueError(f"{name}: expected shape {_text(shape)}, got {array.shape}")
    if finite and not np.isfinite(array).all():
        at = tuple(int(row[0]) for row in np.nonzero(~np.isfinite(array)))
        raise ValueError(f"{name}: expected finite numbers, got {array[at]} at {list(at)}")
    return array


def _text(shape: tuple[int | str, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"


def as_pose(name: str, value: Any) -> Pose:
    """`value`, if it is a pose of finite numbers; ValueError otherwise."""
    if not isinstance(value, Pose):
        found = f"an array of shape {value.shape}" if isinstance(value, np.ndarray) else shown(value)
        raise ValueError(f"{name}: expected a Pose(x, y, theta), got {found}")
    if not (math.isfinite(value.x) and math.isfinite(value.y) and math.isfinite(value.theta)):
        raise ValueError(f"{name}: expected finite numbers, got {value}")
    return value
