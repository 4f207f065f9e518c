"""Selection of keyframes, and the odometry between them."""

from __future__ import annotations

import math

from sixthsense.config import KeyframeConfig
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.source import Tick


class Keyframes:
    """Selects the first scan and those after enough motion since the last one, and folds the odometry between."""

    def __init__(self, config: KeyframeConfig) -> None:
        self._config = config
        self._is_first = True
        self.since = STANDSTILL
        """motion since the last keyframe"""

    def moved(self, increment: Odometry) -> None:
        """Add the motion of a tick."""
        self.since = self.since.then(increment) if self.since is not STANDSTILL else increment

    def due(self, tick: Tick) -> bool:
        """Whether a tick's evidence is used: a scan after enough motion, or observations of landmarks known by name."""
        if tick.scan is None:
            return bool(tick.observations)
        motion = self.since.motion
        distance, turn = math.hypot(motion.x, motion.y), abs(motion.theta)
        far = distance >= self._config.distance_m or turn >= self._config.turn_rad
        return self._is_first or (far and (distance > 0.0 or turn > 0.0))

    def take(self) -> Odometry:
        """The motion since the last keyframe; the sum starts again from zero."""
        motion, self.since, self._is_first = self.since, STANDSTILL, False
        return motion
