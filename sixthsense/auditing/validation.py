"""What cannot be right in poses with covariances, whatever the truth is."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sixthsense.auditing.poses import Poses, is_of_plane
from sixthsense.core.geometry import Array
from sixthsense.evaluation.metrics import has_full_rank

UNIFORM_RAD = math.pi / math.sqrt(3.0)
"""sigma of a direction of which nothing is known"""
_FULL_TURN = 360.0
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def faults(poses: Poses) -> Iterator[str]:
    """A line for each fault of an estimate: which half is first, degrees, rank, stamps."""
    assert poses.covs is not None
    count = len(poses)
    if swapped := of_other_order(poses.covs):
        yield swapped
    covs = (poses.in_plane() if not poses.is_planar and is_of_plane(poses) else poses).covs
    assert covs is not None
    n = 2 if covs.shape[1] == 3 else 3
    largest = np.sqrt(np.maximum(np.einsum("kii->ki", covs)[:, n:].max(axis=1), 0.0))
    if (beyond := int(np.sum(largest > UNIFORM_RAD))) and not swapped:
        yield (
            f"{beyond:,} of {count:,} poses have a rotation of sigma above {UNIFORM_RAD:.2f} rad, that of an unknown "
            f"direction, up to {largest.max():.3g}: in degrees, or of the other order?"
        )
    defective = ~has_full_rank(covs)
    defective[0] &= covs[0].any()  # where its frame begins, a map knows the robot exactly
    if (singular := int(np.sum(defective))) and not swapped:
        yield f"{singular:,} of {count:,} covariances are not positive definite: their poses are left out"


def of_other_order(covs: Array) -> str:
    """Why covariances (N, 6, 6) of a robot on a floor have the rotation first if they are read as translation first.

    Such a robot states x, y and yaw: rows 0, 1 and 5, or with the rotation first 2, 3 and 4.
    """
    if covs.shape[1] != 6:
        return ""
    stated = np.einsum("kii->ki", covs).any(axis=0)
    if stated.tolist() != [False, False, True, True, True, False]:
        return ""
    names = ", ".join(name for name, is_stated in zip(_AXES, stated, strict=True) if is_stated)
    return f"only the variances of {names} are stated: a robot on a floor that has the rotation first (order rotation)"


def of_degrees(headings: Array) -> str:
    """Why (N,) headings are in degrees: they wrap by a full turn of 360; empty if they do not."""
    steps = np.abs(np.diff(headings))
    turns = int(np.sum(np.abs(steps - _FULL_TURN) < 0.1 * _FULL_TURN))
    if not turns or np.abs(headings).max() > 1.01 * _FULL_TURN:
        return ""
    return f"they jump by {steps.max():.0f} where they wrap, {turns} times"
