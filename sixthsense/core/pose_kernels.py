"""Poses in kernels, as triples x, y, theta in m and rad: bit for bit what `Pose` computes."""

from __future__ import annotations

import math

import numba

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
