"""The front end of landmarks whose matches are chosen where scan matching says that the robot is.

Scan matching has a graph of its own. What it says is used to choose matches, and to doubt the wheels where they
slip. The estimator is given odometry and observations, as without it: no aligned pose is a measurement.
"""

from __future__ import annotations

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.core.source import Tick
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.proposed import ProposedLandmarks
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators import Estimator
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.slam.features import NO_FEATURES, Features
from sixthsense.slam.front_end import Keyframe, LoopClosureCounts, Timed
from sixthsense.slam.landmark_front_end import LandmarkFrontEnd
from sixthsense.slam.scans.front_end import ScanFrontEnd


class GuidedFrontEnd(LandmarkFrontEnd):
    """Observations of landmarks in the keyframes of the front end of scans, which proposes where the robot is."""

    def __init__(
        self,
        config: Config,
        estimator: Estimator,
        associator: Associator,
        ransac_rng: np.random.Generator,
        start: Pose,
        timed: Timed,
    ) -> None:
        """Begin at `start`, `T_world_robot`."""
        super().__init__(config, estimator, associator, ransac_rng, start, timed)
        self._guide = ScanFrontEnd(config, ISAM2(start, np.zeros((3, 3)), config.isam2), start, timed)
        self._proposed = ProposedLandmarks()
        self._is_at_guide = True
        """whether the last keyframe is one of the guide's, not of observations that the log gives"""

    @property
    def loop_closure_counts(self) -> LoopClosureCounts | None:
        """Counts of the loop closures of scan matching so far."""
        return self._guide.loop_closure_counts

    def take(self, tick: Tick, scan: Scan | None, increment: Odometry | None) -> Keyframe | None:
        """Process a tick as of landmarks, and place what was seen for the proposals that follow."""
        found = super().take(tick, scan, increment)
        if found is not None and scan is not None:
            seen, records = found.association.observations, self._associator.records
            self._proposed.remember(self._guide.newest, found.estimate, seen, records)
        return found

    def _motion_to(self, tick: Tick, scan: Scan | None, increment: Odometry | None) -> Odometry | None:
        keyframe = self._guide.take(tick, scan, increment)
        if scan is None:
            motion = super()._motion_to(tick, scan, increment)
            self._is_at_guide = self._is_at_guide and motion is None
            return motion
        if keyframe is None:
            return None
        # The guide's motion is since its own last keyframe.
        by_wheels, is_since_guide = self._keyframes.take(), self._is_at_guide
        self._is_at_guide = True
        return keyframe.motion if is_since_guide else by_wheels

    def _associated(self, features: Features, tick: Tick) -> Association:
        if features is NO_FEATURES:
            return super()._associated(features, tick)
        self._proposed.place(self._guide.proposal(), self._estimator.estimate())
        return self._associator.associate(features.observations, self._estimator, self._proposed)
