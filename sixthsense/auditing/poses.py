"""Poses with stamps, of the plane or of space, as an estimate or the truth has them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sixthsense.config.errors import InputError
from sixthsense.core.covariance import COVARIANCE_SLACK, covariance_fault
from sixthsense.core.geometry import Array
from sixthsense.core.source import seconds

Frame = Literal["world", "body"]
Stamps = NDArray[np.int64]

ROWS = {3: [0, 1, 5], 6: [0, 1, 2, 3, 4, 5]}
"""what an error of this size has of x y z roll pitch yaw"""
POSITION = {3: 2, 6: 3}
"""axes of the position, which are the first, by the size of an error"""
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
    """(N, 3), metres; z is 0 in the plane"""
    turns: Rotation
    """N rotations from the body's axes to those of the world"""
    is_planar: bool = False
    """whether the poses are of the plane"""
    covs: Array | None = None
    """(N, d, d), d = 3 or 6, translation first; None for a truth"""
    frame: Frame | None = None
    """whose axes the covariances have by the convention of the file's format; None where it has none"""
    convention: str = ""
    """whose that is, in words; empty where it is that of this package"""
    notes: tuple[str, ...] = ()
    """what was assumed of the file, a line each"""

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def headings(self) -> Array:
        """(N,) radians."""
        return heading(self.turns)

    def part(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Poses:
        """Some of the poses."""
        covs = None if self.covs is None else self.covs[rows]
        return replace(
            self, stamps_ns=self.stamps_ns[rows], positions=self.positions[rows], turns=self.turns[rows], covs=covs
        )

    def in_plane(self) -> Poses:
        """x, y and heading, with their covariances."""
        covs = self.covs
        if covs is not None and covs.shape[1] == 6:
            covs = covs[:, ROWS[3]][:, :, ROWS[3]]
        turns = Rotation.from_rotvec(np.outer(self.headings, (0.0, 0.0, 1.0)))
        return replace(self, positions=self.positions * (1.0, 1.0, 0.0), turns=turns, is_planar=True, covs=covs)


def poses_from(name: str, stamps_ns: Stamps, poses: Array, covs: Array | None = None) -> Poses:
    """Sorted poses from (N, 3) x y theta, (N, 7) x y z qx qy qz qw, (N, 3, 3) or (N, 4, 4) matrices.

    Of poses with the same stamp the first is kept; a note counts those that differ. Raises InputError if that is most
    of them: then stamps are rounded.
    """
    is_planar = poses.shape[1] == 3
    if poses.shape[1:] == (7,):
        positions, turns = poses[:, :3], Rotation.from_quat(poses[:, 3:])
    elif is_planar:
        angles = poses[:, 2] if poses.ndim == 2 else np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
        places = poses[:, :2] if poses.ndim == 2 else poses[:, :2, 2]
        positions, turns = np.pad(places, ((0, 0), (0, 1))), Rotation.from_rotvec(np.outer(angles, (0.0, 0.0, 1.0)))
    else:
        positions, turns = poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3])
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
    return Poses(name, stamps_ns, positions, turns, is_planar, covs, notes=tuple(notes)).part(order)


def heading(turns: Rotation) -> Array:
    """(N,) angles of the body's x axis about the world's z axis, radians."""
    ahead = turns.apply((1.0, 0.0, 0.0))
    return np.arctan2(ahead[:, 1], ahead[:, 0])


def axes(turns: Rotation, size: int) -> Array:
    """Matrices (N, size, size), or one, that turn an error of a pose, translation first."""
    rows = ROWS[size]
    return np.asarray(np.kron(np.eye(2), turns.as_matrix())[..., rows, :][..., rows])


def turned(covs: Array, turns: Rotation) -> Array:
    """Covariances (N, d, d) after N rotations, or one."""
    by = axes(turns, covs.shape[1])
    return np.asarray(by @ covs @ np.swapaxes(by, -1, -2))


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
    level = np.abs(poses.turns.as_matrix()[:, 2, :2]).max() < 1e-9
    return "z, roll and pitch never change" if level and np.ptp(poses.positions[:, 2]) == 0.0 else ""


def same_space(estimate: Poses, truth: Poses) -> tuple[Poses, Poses, list[str]]:
    """Both in the plane or both in space, and notes: why it is the plane, and poses that are tilted there."""
    reason = is_of_plane(estimate) or (is_of_plane(truth) if truth.covs is not None else "")
    if not reason and truth.is_planar:
        reason = "the truth is planar"
    if not reason:
        return estimate, truth, []
    notes = [] if estimate.is_planar else [f"audited as SE(2), x, y and heading: {reason}"]
    notes += [note for one in (estimate, truth) if not one.is_planar for note in _tilted(one)]
    return estimate.in_plane(), truth.in_plane(), notes


def _tilted(poses: Poses) -> list[str]:
    """A line for poses of a robot on a floor whose z axis does not point up."""
    least = float(poses.turns.as_matrix()[:, 2, 2].min())
    if least > _TILTED:
        return []
    angle = math.degrees(math.acos(max(-1.0, least)))
    return [
        f"{poses.name}: the z axis is tilted by up to {angle:.0f}°: is the order qx qy qz qw, and are the axes those "
        "of the robot, x ahead and z up?"
    ]


def check_covariances(poses: Poses) -> None:
    """Raise InputError for what is no covariance, with the stamp of the first one, and for nothing but zeros."""
    covs = poses.covs
    assert covs is not None
    if not covs.any():
        found = "found covariances that are all zero, by which many drivers say 'unknown'"
        raise InputError(poses.name, found, "covariances that the estimator states")
    for stamp_ns, cov in zip(poses.stamps_ns, covs, strict=True):
        if fault := covariance_fault(cov, lowest=-COVARIANCE_SLACK):
            found = f"found {fault} in the covariance at {1e-9 * stamp_ns:.6f} s"
            raise InputError(poses.name, found, "symmetric, no eigenvalue below 0")


def interpolated(poses: Poses, stamps_ns: Stamps) -> tuple[Array, Rotation]:
    """(M, 3) positions and M rotations at stamps within those of `poses`, two or more."""
    own, at = (one - poses.stamps_ns[0] for one in (poses.stamps_ns, stamps_ns))
    positions = np.column_stack([np.interp(at, own, axis) for axis in poses.positions.T])
    return positions, Slerp(own, poses.turns)(at)
