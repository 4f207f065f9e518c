"""Poses with stamps, of the plane or of space, as an estimate or the truth has them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sixthsense.auditing import rotations
from sixthsense.config.errors import InputError
from sixthsense.core.covariance import COVARIANCE_SLACK, covariance_fault
from sixthsense.core.geometry import Array
from sixthsense.core.source import seconds

Frame = Literal["world", "body"]
Stamps = NDArray[np.int64]

PLANE = (0, 1, 5)
"""x, y and yaw of x y z roll pitch yaw"""
_BESIDE = (2, 3, 4)
_TILTED = 0.5  # cosine


@dataclass(frozen=True, slots=True)
class Poses:
    """N poses, sorted by their stamps, no stamp twice."""

    name: str
    """file, with the topic of a bag"""
    stamps_ns: Stamps
    """(N,)"""
    positions: Array
    """(N, n), metres, n = 2 or 3"""
    orientations: Array
    """(N, n, n) rotation matrices, from the body's axes to those of the world"""
    covs: Array | None = None
    """(N, d, d), d = 3 or 6, translation first; None for a truth"""
    frame: Frame | None = None
    """whose axes the covariances have by the convention of the file's format; None where it has none"""
    frames: tuple[str, str] = ("", "")
    """names of the parent and the child frame, of a bag"""
    notes: tuple[str, ...] = ()
    """what was assumed of the file, a line each"""

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def part(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Poses:
        """Some of the poses."""
        covs = None if self.covs is None else self.covs[rows]
        return replace(
            self, stamps_ns=self.stamps_ns[rows], positions=self.positions[rows],
            orientations=self.orientations[rows], covs=covs,
        )  # fmt: skip

    @property
    def is_planar(self) -> bool:
        """Whether the poses are of the plane."""
        return bool(self.positions.shape[1] == 2)

    def in_plane(self) -> Poses:
        """x, y and heading, with their covariances."""
        if self.is_planar:
            return self
        covs = self.covs
        if covs is not None and covs.shape[1] == 6:
            covs = covs[:, PLANE][:, :, PLANE]
        turn = rotations.exp(rotations.yaw(self.orientations)[:, None])
        return replace(self, positions=self.positions[:, :2], orientations=turn, covs=covs)


def poses_from(name: str, stamps_ns: Stamps, poses: Array, covs: Array | None = None) -> Poses:
    """Sorted poses from (N, 3) x y theta, (N, 7) x y z qx qy qz qw, (N, 3, 3) or (N, 4, 4) matrices.

    Of poses with the same stamp the first is kept; a note counts those that differ. Raises InputError if that is most
    of them: then stamps are rounded.
    """
    if poses.shape[1:] == (3,):
        positions, turns = poses[:, :2], rotations.exp(poses[:, 2:])
    elif poses.shape[1:] == (7,):
        positions, turns = poses[:, :3], rotations.of_quaternions(poses[:, 3:])
    else:
        n = poses.shape[1] - 1
        positions, turns = poses[:, :n, n], poses[:, :n, :n]
    stamps, order, kept = np.unique(stamps_ns, return_index=True, return_inverse=True)
    differ = np.flatnonzero((poses != poses[order[kept]]).reshape(len(poses), -1).any(axis=1))
    if 2 * len(differ) > len(poses):
        found = f"found {len(poses):,} poses at {len(stamps):,} stamps, from {seconds(int(stamps[0])):.6g} s on"
        raise InputError(name, found, "a stamp for each pose with all of its digits, not rounded as by %.6g")
    notes = []
    if len(differ):
        at_s = seconds(int(stamps_ns[differ[0]]))
        count = f"{len(differ):,} poses have the stamp of another one"
        notes = [f"{name}: {count}, the first at {at_s:.6f} s: the first of each stamp is kept"]
    return Poses(name, stamps_ns, positions, turns, covs, notes=tuple(notes)).part(order)


def is_of_plane(poses: Poses) -> str:
    """Why covariances of space are those of a robot on a floor, empty if they are not.

    Many drivers of planar robots leave the variances of z, roll and pitch at zero, and others put a large or small
    constant there.
    """
    assert poses.covs is not None
    if poses.is_planar or poses.covs.shape[1] == 3:
        return "its covariances are of x, y and heading"
    if not poses.covs[:, _BESIDE, _BESIDE].any():
        return "the variances of z, roll and pitch are zero"
    level = np.abs(poses.orientations[:, 2, :2]).max() < 1e-9
    if level and np.ptp(poses.positions[:, 2]) == 0.0:
        return "z, roll and pitch never change"
    return ""


def tilted(name: str, orientations: Array) -> list[str]:
    """A line for poses of a robot on a floor, (N, 3, 3), whose z axis does not point up."""
    least = float(orientations[:, 2, 2].min())
    if least > _TILTED:
        return []
    angle = math.degrees(math.acos(max(-1.0, least)))
    return [
        f"{name}: the z axis is tilted by up to {angle:.0f}°: is the order qx qy qz qw, and are the axes those of the "
        "robot, x ahead and z up?"
    ]


def check_covariances(poses: Poses) -> None:
    """Raise InputError for what is no covariance, with the stamp of the first one, and for nothing but zeros."""
    covs = poses.covs
    assert covs is not None
    if not covs.any():
        raise InputError(
            poses.name,
            "found covariances that are all zero, by which many drivers say 'unknown'",
            "covariances that the estimator states",
        )
    for stamp_ns, cov in zip(poses.stamps_ns, covs, strict=True):
        if fault := covariance_fault(cov, lowest=-COVARIANCE_SLACK):
            found = f"found {fault} in the covariance at {1e-9 * stamp_ns:.6f} s"
            raise InputError(poses.name, found, "symmetric, no eigenvalue below 0")


def interpolated(poses: Poses, stamps_ns: Stamps) -> tuple[Array, Array]:
    """(M, n) positions and (M, n, n) orientations at stamps within those of `poses`; exact at a stamp of a pose."""
    after = np.clip(np.searchsorted(poses.stamps_ns, stamps_ns), 1, len(poses) - 1)
    before = after - 1
    gap = (poses.stamps_ns[after] - poses.stamps_ns[before]).astype(np.float64)
    share = ((stamps_ns - poses.stamps_ns[before]) / gap)[:, None]
    first, last = poses.positions[before], poses.positions[after]
    positions = np.where(share == 1.0, last, first + share * (last - first))
    turn = rotations.log(rotations.transposed(poses.orientations[before]) @ poses.orientations[after])
    between = poses.orientations[before] @ rotations.exp(share * turn)
    return positions, np.where(share[:, :, None] == 1.0, poses.orientations[after], between)
