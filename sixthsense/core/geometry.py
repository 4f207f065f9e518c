"""Planar rigid motions, angles and segments. Metres, radians; x forward, y left, angles counter-clockwise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.core.se2 import Array as Array
from sixthsense.core.se2 import compose, inverse, wrapped

Angle = TypeVar("Angle", float, Array)
Mapped = TypeVar("Mapped", "Pose", Array)

_set = object.__setattr__  # of a frozen value


def wrap_angle(angle: Angle) -> Angle:
    """Wrap an angle, or an array of them, into [-pi, pi); an angle in that interval is returned bit for bit."""
    if not isinstance(angle, np.ndarray):
        return float(wrapped(float(angle)))
    inside = (angle + math.pi) % (2.0 * math.pi) - math.pi
    # The modulo of a tiny negative number rounds up to 2 pi itself.
    inside = np.where(inside >= math.pi, -math.pi, inside)
    return np.where((angle >= -math.pi) & (angle < math.pi), angle, inside)


def rotation(theta: float) -> Array:
    """(2, 2) rotation matrix of the angle `theta`."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, slots=True, init=False)
class Pose:
    """A rigid motion of the plane, `T_a_b`: frame b seen from frame a.

    `T_a_b @ T_b_c` is a Pose; `T_a_b @ points_b` maps an (N, 2) or (2,) array into frame a.
    """

    x: float = 0.0
    """metres"""
    y: float = 0.0
    """metres"""
    theta: float = 0.0
    """radians, kept in [-pi, pi)"""

    def __init__(self, x: float = 0.0, y: float = 0.0, theta: float = 0.0) -> None:
        # Written out: every control tick makes a dozen poses, and a dataclass would set each field twice.
        try:
            angle, x, y = float(theta), float(x), float(y)
        except (TypeError, ValueError):
            found = ", ".join(map(shown, (x, y, theta)))
            allowed = "three numbers x, y, theta; of an array, Pose.from_array"
            raise InputError("pose", f"found {found}", allowed) from None
        _set(self, "x", x)
        _set(self, "y", y)
        _set(self, "theta", angle if -math.pi <= angle < math.pi else wrap_angle(angle))

    @classmethod
    def from_array(cls, values: Any) -> Pose:
        """Build a pose from three numbers (x, y, theta); ValueError for any other count."""
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (3,):
            raise ValueError(f"pose: expected shape (3,), got {array.shape}")
        return cls(*array.tolist())

    def triple(self) -> tuple[float, float, float]:
        """x, y, theta, as kernels take a pose."""
        return self.x, self.y, self.theta

    def array(self) -> Array:
        """(3,): x, y, theta."""
        return np.array([self.x, self.y, self.theta])

    @property
    def position(self) -> Array:
        """(2,): x, y."""
        return np.array([self.x, self.y])

    def inverse(self) -> Pose:
        """`T_b_a` of `T_a_b`."""
        return Pose(*inverse(self.triple()))

    def adjoint(self) -> Array:
        """(3, 3) adjoint of `T_a_b`: turns a small motion (x, y, theta) in the axes of b into the same in those of a.

        The product of poses keeps it: `(T_a_b @ T_b_c).adjoint()` is the product of both adjoints. Without translation
        it turns axes only (Sola, Deray and Atchuthan, "A micro Lie theory", arXiv 1812.01537, appendix C).
        """
        c, s = math.cos(self.theta), math.sin(self.theta)
        return np.array([[c, -s, self.y], [s, c, 0.0 - self.x], [0.0, 0.0, 1.0]])  # 0.0 - x, since -0.0 is not 0.0

    def __matmul__(self, other: Mapped) -> Mapped:
        if isinstance(other, Pose):
            return Pose(*compose(self.triple(), other.triple()))
        c, s = math.cos(self.theta), math.sin(self.theta)
        points = np.asarray(other, dtype=np.float64)
        if points.shape[-1:] != (2,):
            raise ValueError(f"points: expected shape (N, 2) or (2,), got {points.shape}")
        mapped = np.empty_like(points)
        mapped[..., 0] = self.x + c * points[..., 0] - s * points[..., 1]
        mapped[..., 1] = self.y + s * points[..., 0] + c * points[..., 1]
        return mapped


def interpolated(stamps_s: Array, poses: Array, times_s: Array) -> Array:
    """(N, 3) poses at (N,) times, interpolated in (K, 3) `poses` at ascending (K,) stamps, constant beyond both ends.

    x, y and the heading, along the shorter arc, are interpolated linearly.
    """
    if len(stamps_s) == 1:
        return np.repeat(poses, len(times_s), axis=0)
    after = np.clip(np.searchsorted(stamps_s, times_s), 1, len(stamps_s) - 1)
    before = after - 1
    share = np.clip((times_s - stamps_s[before]) / (stamps_s[after] - stamps_s[before]), 0.0, 1.0)
    motion = poses[after] - poses[before]
    motion[:, 2] = wrap_angle(motion[:, 2])
    return np.asarray(poses[before] + share[:, None] * motion)


def point_segment_distance(point: Array, segments: Array) -> Array:
    """(N,) distances from a (2,) point to (N, 2, 2) segments, in metres; (P, N) from points (P, 1, 2)."""
    start = segments[:, 0]
    along = segments[:, 1] - start
    length_sq = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
    t = np.clip(np.einsum("...j,...j->...", point - start, along) / length_sq, 0.0, 1.0)
    return np.asarray(np.linalg.norm(start + t[..., None] * along - point, axis=-1))
