"""The front end of landmarks: predict, extract, associate, update."""

from __future__ import annotations

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.core.source import Tick
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators import Estimate, Estimator
from sixthsense.slam.features import NO_FEATURES, Features, extract
from sixthsense.slam.front_end import Keyframe, LoopClosureCounts, PoseLinks, Timed
from sixthsense.slam.keyframes import Keyframes


class LandmarkFrontEnd:
    """Observations of landmarks in keyframes, which are selected by odometry."""

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
        self._config, self._estimator, self._associator = config, estimator, associator
        self._ransac_rng, self._pose = ransac_rng, start
        self._keyframes = Keyframes(config.keyframes)
        self._predict = timed("predict", estimator.predict)
        self._extract = timed("extract", self._extracted)
        self._associate = timed("associate", self._associated)
        self._update = timed("update", self._updated)

    @property
    def pose(self) -> Pose:
        """`T_world_robot`: the last estimate, and the odometry since."""
        return self._pose

    @property
    def since_keyframe(self) -> Pose:
        """Odometry since the last keyframe."""
        return self._keyframes.since.motion

    @property
    def since_cov(self) -> Array:
        """(3, 3) of that motion's error, axes of the keyframe."""
        return self._keyframes.since.cov

    def take(self, tick: Tick, scan: Scan | None, increment: Odometry | None) -> Keyframe | None:
        """Process a tick: on keyframes, observations are extracted, matched with landmarks and fused."""
        if increment is not None:
            self._keyframes.moved(increment)
            self._pose = self._pose @ increment.motion
        motion = self._motion_to(tick, scan, increment)
        if motion is None:
            return None
        self._predict(motion)
        features = NO_FEATURES if scan is None else self._extract(scan)
        association = self._associate(features, tick)
        if association.slip is not None:
            self._predict(association.slip)
            motion = motion.then(association.slip)
        predicted = self._estimator.estimate()
        estimate = self._update(association)
        self._pose = estimate.pose
        return Keyframe(motion, predicted, estimate, association, features)

    @property
    def loop_closure_counts(self) -> LoopClosureCounts | None:
        """None: old places are found by their landmarks alone."""
        return None

    def links(self) -> PoseLinks | None:
        """None: landmarks make no links."""
        return None

    def finish(self) -> Array | None:
        """Predict up to the last tick."""
        self._estimator.predict(self._keyframes.take())
        return None

    def _motion_to(self, tick: Tick, scan: Scan | None, increment: Odometry | None) -> Odometry | None:
        """The motion since the last keyframe, if this tick's evidence is used."""
        return self._keyframes.take() if self._keyframes.due(tick) else None

    def _extracted(self, scan: Scan) -> Features:
        return extract(scan, self._config.assumed, self._config.features, self._ransac_rng)

    def _associated(self, features: Features, tick: Tick) -> Association:
        if features is NO_FEATURES:
            return self._associator.known(tick.observations or {}, self._estimator)
        return self._associator.associate(features.observations, self._estimator)

    def _updated(self, association: Association) -> Estimate:
        self._estimator.update(association.observations)
        estimate = self._estimator.estimate()
        gone = self._associator.forgotten(self._estimator, estimate)
        if gone:
            self._estimator.forget(gone)
            estimate = self._estimator.estimate()
        return estimate
