"""Circular arcs, the paths of a differential drive at constant speed and turn rate."""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import Triple, wrapped


@numba.njit(cache=True, error_model="numpy")
def _sinc(angle: float) -> float:
    return 1.0 - angle * angle / 6.0 if abs(angle) < 1e-4 else math.sin(angle) / angle


@numba.njit(cache=True, error_model="numpy")
def arc_length(x: float, y: float, turn: float) -> float:
    """Length (m, signed) of the circular arc that ends at (x, y) after a turn (rad)."""
    half = 0.5 * turn
    chord = x * math.cos(half) + y * math.sin(half)
    return chord / _sinc(half)


@numba.njit(cache=True, error_model="numpy")
def arc_jacobian(distance: float, turn: float) -> Array:
    """Jacobian (3, 2) of an arc's end (x, y, theta), axes of that end, by its length (m, signed) and turn (rad)."""
    half = 0.5 * turn
    c, s, sinc = math.cos(half), math.sin(half), _sinc(half)
    slope = -half / 3.0 if abs(half) < 1e-4 else (math.cos(half) - sinc) / half  # d sinc / d half
    return np.array(
        [
            [sinc * c, 0.5 * distance * (slope * c + sinc * s)],
            [-sinc * s, 0.5 * distance * (sinc * c - slope * s)],
            [0.0, 1.0],
        ]
    )


@numba.njit(cache=True, error_model="numpy")
def driven(pose: Triple, speed: float, turn_rate: float, step_s: float, steps: int) -> Triple:
    """Propagate a differential drive at constant speed (m/s) and turn rate (rad/s), in RK4 steps of `step_s`.

    Report eq. 6-7. The heading of a differential drive depends on time alone, so k2 equals k3.
    """
    x, y, theta = pose
    for _ in range(steps):
        middle, end = theta + 0.5 * step_s * turn_rate, theta + step_s * turn_rate
        x += step_s / 6.0 * speed * (math.cos(theta) + 4.0 * math.cos(middle) + math.cos(end))
        y += step_s / 6.0 * speed * (math.sin(theta) + 4.0 * math.sin(middle) + math.sin(end))
        theta = end
    return x, y, wrapped(theta)
