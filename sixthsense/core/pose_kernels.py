"""Poses in kernels, as triples x, y, theta in m and rad: bit for bit what `Pose` computes; and circular arcs."""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array, Pose


@numba.njit(cache=True, error_model="numpy")
def _sinc(angle: float) -> float:
    return 1.0 - angle * angle / 6.0 if abs(angle) < 1e-4 else math.sin(angle) / angle


def arc(motion: Pose) -> tuple[float, float]:
    """Length (m, signed) and turn (rad) of the circular arc with the end pose `motion`, as of a differential drive."""
    return arc_length(motion.x, motion.y, motion.theta), motion.theta


@numba.njit(cache=True, error_model="numpy")
def arc_length(x: float, y: float, turn: float) -> float:
    """Length (m, signed) of the circular arc that ends at (x, y) after a turn (rad)."""
    half = 0.5 * turn
    chord = x * math.cos(half) + y * math.sin(half)
    return chord / _sinc(half)


@numba.njit(cache=True, error_model="numpy")
def arc_jacobian(distance: float, turn: float) -> Array:
    """Jacobian (3, 2) of an arc's end (x, y, theta), frame of its start, by its length (m, signed) and turn (rad)."""
    half = 0.5 * turn
    c, s, sinc = math.cos(half), math.sin(half), _sinc(half)
    slope = -half / 3.0 if abs(half) < 1e-4 else (math.cos(half) - sinc) / half  # d sinc / d half
    return np.array(
        [
            [sinc * c, 0.5 * distance * (slope * c - sinc * s)],
            [sinc * s, 0.5 * distance * (slope * s + sinc * c)],
            [0.0, 1.0],
        ]
    )


Triple = tuple[float, float, float]


@numba.njit(cache=True, error_model="numpy")
def wrapped(angle: float) -> float:
    """The angle in [-pi, pi), as `wrap_angle` has it."""
    if -math.pi <= angle < math.pi:
        return angle
    inside = (angle + math.pi) % (2.0 * math.pi) - math.pi
    # The modulo of a tiny negative number rounds up to 2 pi itself.
    return -math.pi if inside >= math.pi else inside


@numba.njit(cache=True, error_model="numpy")
def composed(a: Triple, b: Triple) -> Triple:
    """`T_a_c` of `T_a_b` and `T_b_c`."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrapped(a[2] + b[2])


@numba.njit(cache=True, error_model="numpy")
def inverted(a: Triple) -> Triple:
    """`T_b_a` of `T_a_b`."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return -c * a[0] - s * a[1], s * a[0] - c * a[1], wrapped(-a[2])


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
