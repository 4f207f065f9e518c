"""The front end of landmarks: predict, extract, associate, update.

A guide, the front end of scans with a graph of its own, may propose where the robot is. What it says is used to choose
matches, and to doubt the wheels where they slip. The estimator is given odometry and observations, as without it: no
aligned pose is a measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sixthsense.config import Config
from sixthsense.config.parts import EXTRACTORS
from sixthsense.config.tree import check_returned, part_of
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.source import Closure
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.proposed import ProposedLandmarks
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators import Estimate, Estimator, Smoother
from sixthsense.slam.estimators.base import Link
from sixthsense.slam.features import NO_FEATURES, Extractor, Features
from sixthsense.slam.front_end import Clock, Evidence, Finished, FrontEndSetup, Keyframe, is_due
from sixthsense.slam.motion_source import ByWheels, Motion

if TYPE_CHECKING:
    from sixthsense.slam.scans.front_end import ScanFrontEnd


class LandmarkFrontEnd:
    """Observations of landmarks in keyframes, which odometry selects, or the guide."""

    def __init__(
        self,
        config: Config,
        estimator: Estimator,
        associator: Associator,
        extractor: Extractor,
        start: Pose,
        clock: Clock,
        guide: ScanFrontEnd | None = None,
    ) -> None:
        """Begin at `start`, `T_world_robot`."""
        self._config, self._estimator, self._associator = config, estimator, associator
        self._extractor, self._clock = extractor, clock
        self.pose = start
        """`T_world_robot`: the last estimate, and the odometry since"""
        self.since = STANDSTILL
        """odometry since the last keyframe"""
        self._keyframes = 0
        self._guide = guide
        self._proposed = ProposedLandmarks()
        self._is_at_guide = True
        """whether the last keyframe is one of the guide's, not of observations that the log gives"""

    def take(self, evidence: Evidence) -> Keyframe | None:
        """Process a tick: on keyframes, observations are extracted, matched with landmarks and fused."""
        if evidence.increment is not None:
            self.since = self.since.then(evidence.increment)
            self.pose = self.pose @ evidence.increment.motion
        motion = self._keyframe_motion(evidence)
        if motion is None:
            return None
        with self._clock("predict"):
            self._estimator.predict(motion)
        features = NO_FEATURES
        if evidence.scan is not None:
            with self._clock("extract"):
                features = self._extractor.extract(evidence.scan)
            if self._config.extractor not in EXTRACTORS.shipped:
                name = f"extractor {self._config.extractor}"
                check_returned(name, "extract", features, Features)
                for one in features.observations:
                    check_returned(name, "extract", one, Observation, z=(2,), cov=(2, 2))
        with self._clock("associate"):
            association = self._associated(features, evidence)
        if association.slip is not None:
            self._estimator.predict(association.slip)
            motion = motion.then(association.slip)
        predicted = self._estimator.estimate()
        with self._clock("update"):
            estimate = self._updated(association, evidence.closures)
        self.pose, index, self._keyframes = estimate.pose, self._keyframes, self._keyframes + 1
        if self._guide is not None and evidence.scan is not None:
            seen, records = association.observations, self._associator.records
            self._proposed.remember(self._guide.newest, estimate, seen, records)
        counts = None if self._guide is None else self._guide.counts
        return Keyframe(index, motion, predicted, estimate, association, features, counts)

    def finish(self) -> Finished:
        """Predict up to the last tick."""
        self._estimator.predict(self._taken())
        return Finished(self._estimator.estimate())

    def _taken(self) -> Odometry:
        """The motion since the last keyframe; the sum starts again from zero."""
        since, self.since = self.since, STANDSTILL
        return since

    def _keyframe_motion(self, evidence: Evidence) -> Odometry | None:
        """The motion since the last keyframe, if this tick's evidence is used.

        A scan is used after enough motion, or where it is one of the guide's keyframes; named observations always are,
        and the poses of a log with loop closures.
        """
        if self._guide is not None:
            guided = self._guide.take(evidence)
            if evidence.scan is not None:
                return None if guided is None else self._guided_motion(guided)
        elif evidence.scan is not None:
            is_used = self._keyframes == 0 or is_due(self.since.motion, self.since, self._config.keyframes)
            return self._taken() if is_used else None
        if not evidence.observations and evidence.closures is None:
            return None
        self._is_at_guide = False
        return self._taken()

    def _guided_motion(self, guided: Keyframe) -> Odometry:
        """The guide's motion since its own last keyframe; the wheels' where observations were used since."""
        by_wheels, is_since_guide = self._taken(), self._is_at_guide
        self._is_at_guide = True
        return guided.motion if is_since_guide else by_wheels

    def _associated(self, features: Features, evidence: Evidence) -> Association:
        if evidence.scan is None:
            return self._associator.match_named(evidence.observations, self._estimator)
        if self._guide is not None:  # which has compared the whole scan
            self._proposed.place(self._guide.proposal(), self._estimator.estimate())
            return self._associator.associate(features.observations, self._estimator, self._proposed)
        return self._associator.associate(features.observations, self._estimator)

    def _updated(self, association: Association, closures: Sequence[Closure] | None) -> Estimate:
        self._estimator.update(association.observations)
        if closures and isinstance(self._estimator, Smoother):
            links = [Link(each.before, self._keyframes, Odometry(each.motion, each.cov)) for each in closures]
            self._estimator.link(links)
        estimate = self._estimator.estimate()
        gone = self._associator.forgotten(self._estimator, estimate)
        if gone:
            self._estimator.forget(gone)
            estimate = self._estimator.estimate()
        return estimate


def landmark_front_end(setup: FrontEndSetup) -> LandmarkFrontEnd:
    """The front end of landmarks, with a guide where the configuration wants matches to be proposed."""
    config, estimator, start, associator, _, clock = setup
    extractor: Extractor = part_of(config, EXTRACTORS).make(config.assumed)
    guide = None
    if config.association.proposed_by == "scan-matching":
        from sixthsense.slam.estimators.isam2 import ISAM2
        from sixthsense.slam.scans.front_end import ScanFrontEnd

        smoother = ISAM2(start, np.zeros((3, 3)), config.isam2)
        guide = ScanFrontEnd(config, smoother, start, Motion(ByWheels(config.assumed)), clock, is_guide=True)
    return LandmarkFrontEnd(config, estimator, associator, extractor, start, clock, guide)
