"""The front end of landmarks: predict, extract, associate, update.

A guide, the front end of scans with a graph of its own, may propose where the robot is. What it says is used to choose
matches, and to doubt the wheels where they slip. The estimator is given odometry and observations, as without it: no
aligned pose is a measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sixthsense.config.parts import EXTRACTORS
from sixthsense.config.tree import part_of
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.source import Closure
from sixthsense.slam.association.proposed import ProposedLandmarks
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators import Estimate, Smoother
from sixthsense.slam.estimators.base import Link
from sixthsense.slam.estimators.motion_source import ByWheels, Motion
from sixthsense.slam.estimators.thinning import Thinning
from sixthsense.slam.features import NO_FEATURES, Extractor, Features
from sixthsense.slam.features.extractor import check_features
from sixthsense.slam.front_end import Evidence, Finished, FrontEndSetup, Keyframe, is_due

if TYPE_CHECKING:
    from sixthsense.slam.scans.front_end import ScanFrontEnd


class LandmarkFrontEnd:
    """Observations of landmarks in keyframes, which odometry selects, or the guide."""

    def __init__(self, setup: FrontEndSetup) -> None:
        """Begin at the start, with a guide where the configuration wants matches to be proposed."""
        self._config, self._estimator, self.pose, self._associator, _, self._clock = setup
        self._extractor: Extractor = part_of(self._config, EXTRACTORS).make(self._config.assumed)
        self.since = STANDSTILL
        """odometry since the last keyframe"""
        self._showed_new: list[bool] = []
        """whether each keyframe showed a landmark that was new"""
        self._gone: list[int] = []
        """keyframes that have left a smoother's graph"""
        self._thinning = Thinning()
        self._guide: ScanFrontEnd | None = None
        self._proposed = ProposedLandmarks()
        if self._config.association.proposed_by == "scan-matching":
            from sixthsense.slam.estimators.isam2 import ISAM2
            from sixthsense.slam.scans.front_end import ScanFrontEnd

            smoother = ISAM2(self.pose, np.zeros((3, 3)), self._config.isam2)
            wheels, config = Motion(ByWheels(self._config.assumed)), self._config.replaced(scans={"final_pass": False})
            self._guide = ScanFrontEnd(setup._replace(config=config, estimator=smoother, motion=wheels))

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
                check_features(f"extractor {self._config.extractor}", features)
        with self._clock("associate"):
            association = self._associated(features, evidence)
        if association.slip is not None:
            self._estimator.predict(association.slip)
            motion = motion.then(association.slip)
        predicted = self._estimator.estimate()
        with self._clock("update"):
            estimate = self._updated(association, evidence.closures)
        self.pose = estimate.pose
        self._showed_new.append(not association.observations.keys() <= set(predicted.ids.tolist()))
        if isinstance(self._estimator, Smoother):
            poses, showed_new = self._estimator.trajectory(), self._showed_new
            kept = ~np.isin(np.arange(len(poses)), self._gone)
            if leaving := self._thinning.leaving(poses, kept, lambda k: showed_new[k]):
                self._estimator.take_out(leaving)
                self._gone += leaving
        if self._guide is not None and evidence.scan is not None:
            self._proposed.remember(self._guide.newest, estimate, association.observations, self._associator.records)
        counts = None if self._guide is None else self._guide.counts
        return Keyframe(len(self._showed_new) - 1, motion, predicted, estimate, association, features, counts)

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

        A scan is used after enough motion, or where it is one of the guide's keyframes, with the guide's motion if it
        has all keyframes; named observations always are, and the poses of a log with loop closures.
        """
        if self._guide is not None:
            guided = self._guide.take(evidence)
            if evidence.scan is not None:
                if guided is None:
                    return None
                by_wheels = self._taken()
                return guided.motion if guided.index == len(self._showed_new) else by_wheels
        elif evidence.scan is not None:
            is_used = not self._showed_new or is_due(self.since.motion, self.since, self._config.keyframes)
            return self._taken() if is_used else None
        if not evidence.observations and evidence.closures is None:
            return None
        return self._taken()

    def _associated(self, features: Features, evidence: Evidence) -> Association:
        if evidence.scan is None:
            return self._associator.match_named(evidence.observations, self._estimator)
        proposed = None
        if self._guide is not None:  # which has compared the whole scan
            proposed = self._proposed
            proposed.place(*self._guide.proposal(), self._estimator.estimate())
        return self._associator.associate(features.observations, self._estimator, proposed)

    def _updated(self, association: Association, closures: Sequence[Closure] | None) -> Estimate:
        self._estimator.update(association.observations)
        if closures and isinstance(self._estimator, Smoother):
            links = [Link(each.before, len(self._showed_new), Odometry(each.motion, each.cov)) for each in closures]
            self._estimator.link(links)
        estimate = self._estimator.estimate()
        if gone := self._associator.forgotten(self._estimator, estimate):
            self._estimator.forget(gone)
            estimate = self._estimator.estimate()
        return estimate
