"""The map of an earlier run, that another run begins with."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.parts import NEEDS_FILTER
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId
from sixthsense.core.laser import Scan
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators import Estimator, Filter, LandmarkPrior
from sixthsense.slam.mapping.submap import Submap


class KeyScans(NamedTuple):
    """Scans of keyframes, and where they were taken."""

    scans: Sequence[Scan]
    poses: Array
    """(K, 3) `T_world_robot`"""

    @classmethod
    def of(cls, scans: Sequence[Scan | None], trajectory: Array) -> KeyScans:
        """Those of a trajectory's keyframes that have a scan."""
        rows = [k for k, scan in enumerate(scans) if scan is not None]
        return cls([scan for scan in scans if scan is not None], trajectory[rows])


@dataclass(frozen=True, slots=True)
class PriorMap:
    """What a run has found of a building: landmarks with their joint covariance, and the evidence of cells."""

    name: str
    """of the run's folder"""
    digest: str
    """SHA-256 of its files, hexadecimal"""
    landmarks: LandmarkPrior
    records: Mapping[LandmarkId, Record]
    """of each landmark, as at the end of that run"""
    evidence: Submap
    """of the obstacle map; empty for a run without scans"""
    cell_m: float
    """side of its cells"""
    scans: KeyScans
    """of its keyframes; none for a run without scans"""

    def fresh_records(self) -> dict[LandmarkId, Record]:
        """Copies of the records; first and last keyframe are those of the new run, 0."""
        return {i: replace(copy.deepcopy(each), first_scan=0, last_scan=0) for i, each in self.records.items()}


class PriorStart(NamedTuple):
    """A prior map, and where in it the robot begins."""

    map: PriorMap
    pose: Pose | None = None
    """`T_world_robot`; None: where the scene or the log says"""
    sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """of x, y and theta, m and rad; 0: known"""
    is_lost: bool = False
    """whether the pose is unknown, and has to be found by driving"""

    def note(self) -> dict[str, Any]:
        """What a run's record says of it; a pose only where it was given."""
        if self.is_lost:
            return {"name": self.map.name, "digest": self.map.digest, "lost": True}
        given = {} if self.pose is None else {"pose": self.pose.array().tolist()}
        return {"name": self.map.name, "digest": self.map.digest, **given, "pose_sigma": list(self.sigma)}

    @property
    def cov(self) -> Array:
        """(3, 3) of the pose, world frame."""
        return np.diag(np.square(self.sigma))


def begin_with(prior: PriorMap, config: Config, estimator: Estimator) -> None:
    """Give the estimator the landmarks; InputError where this configuration cannot be used with the map."""
    check_usable(prior, config)
    if not isinstance(estimator, Filter):
        raise InputError("estimator", f"found {config.estimator} with a prior map", NEEDS_FILTER)
    estimator.start_from(prior.landmarks)


def check_usable(prior: PriorMap, config: Config) -> None:
    """Raise InputError for a configuration that cannot be used with the map, whatever the start."""
    if config.front_end != "landmarks":
        raise InputError("front_end", f"found {config.front_end} with a prior map", "landmarks")
    if config.association.proposed_by != "estimate":
        found = f"found {config.association.proposed_by} with a prior map"
        raise InputError("association.proposed_by", found, "estimate")
    if len(prior.evidence.cells) and not math.isclose(prior.cell_m, config.grid.cell_m):
        found = f"found {config.grid.cell_m:g} with a prior map of {prior.cell_m:g} m cells"
        raise InputError("grid.cell_m", found, "the same")
