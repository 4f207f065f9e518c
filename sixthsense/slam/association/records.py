"""What the association says of one keyframe, and what it keeps of each landmark."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sixthsense.config.removed import OldName
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.crookedness import Footprint, MeanShape, correlation
from sixthsense.slam.association.wall_extents import ends, joined


@dataclass(frozen=True, slots=True)
class Association:
    """The observations of one keyframe with the landmarks they are of."""

    observations: Mapping[LandmarkId, Observation] = field(default_factory=dict)
    """those to update with; an id that the estimator does not know is a new landmark"""
    discarded: int = 0
    """observations that are too far for a match and too near for a new landmark"""
    nis: float = 0.0
    """normalised innovation squared of all matches together, before the update"""
    dof: int = 0
    """its degrees of freedom, 2 per match"""
    fused: int = 0
    """observations that were fused with another one of the same wall"""
    slip: Odometry | None = None
    """motion that the odometry has missed, if the scan matches only with it"""
    sightings = OldName("sightings", "observations")


@dataclass(slots=True)
class Record:
    """What the associator keeps of a landmark, beside the estimator's two numbers."""

    kind: Kind
    """of its first observation"""
    observations: int
    """observations so far, the first included"""
    first_scan: int
    """keyframe of its first observation"""
    last_scan: int
    """keyframe of its last observation"""
    sigma_m: float = math.inf
    """upper bound of a point's sigma along any direction, when it was last compared"""
    extent: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """(2, 2) ends of what was seen of a wall, world frame; unused for a point"""
    shape: MeanShape = field(default_factory=MeanShape)
    """of a wall"""
    footprint: Footprint | None = None
    """of the last observation of a wall; None of a wall of an earlier run"""
    stretches: list[Footprint] = field(default_factory=list)
    """of a wall that is not straight: what was seen of it at once, each hardly like the others"""
    sightings = OldName("sightings", "observations")

    def seen_again(self, observation: Observation, pose: Pose, wall: Array) -> Observation:
        """An observation of this wall (2,) from `pose`, with what its shape's error has in common with the last one."""
        seen = ends(pose, observation)
        self.shape.add(observation.shape)
        self.extent = joined(wall, self.extent, seen)
        before, self.footprint = self.footprint, Footprint.of(pose, seen)
        if observation.shape_cov is None:
            return observation
        kept = 0.0 if before is None else correlation(before, self.footprint)
        stretch = self.stretch_of(self.footprint)
        alike = correlation(self.stretches[stretch], self.footprint)
        return replace(observation, shape_kept=kept, stretch=stretch, stretch_kept=alike)

    def stretch_of(self, seen: Footprint) -> int:
        """Number of the stretch that is most like what was seen; a new one, if none has most of its error."""
        alike = [correlation(stretch, seen) for stretch in self.stretches]
        if alike and max(alike) > 0.5:
            return alike.index(max(alike))
        self.stretches.append(seen)
        return len(self.stretches) - 1
