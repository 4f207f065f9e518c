"""The configured front end."""

from __future__ import annotations

from sixthsense.config import Config, ConfigError
from sixthsense.config.names import KEEP_POSES
from sixthsense.core.geometry import Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import Estimator, Smoother
from sixthsense.slam.front_end import FrontEnd, Timed
from sixthsense.slam.landmark_front_end import LandmarkFrontEnd
from sixthsense.slam.last_velocity import LastVelocity


def make_front_end(
    config: Config,
    estimator: Estimator,
    associator: Associator,
    start: Pose,
    timed: Timed,
    velocity: LastVelocity | None,
) -> FrontEnd:
    """The configured front end at `start`, `T_world_robot`; ConfigError for one that the estimator cannot use.

    `velocity` moves a robot without odometry.
    """
    if config.front_end == "landmarks":
        args = config, estimator, associator, random_streams(config.seed).ransac, start, timed
        if config.association.proposed_by == "estimate":
            return LandmarkFrontEnd(*args)
        from sixthsense.slam.guided_front_end import GuidedFrontEnd

        return GuidedFrontEnd(*args)
    if not isinstance(estimator, Smoother):
        raise ConfigError(f"front_end: found scan-matching with {config.estimator}, {KEEP_POSES}")
    from sixthsense.slam.scans.front_end import ScanFrontEnd

    return ScanFrontEnd(config, estimator, start, timed, velocity)
