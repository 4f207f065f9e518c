"""Driving to a list of goals."""

from __future__ import annotations

import itertools

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.navigator import Event, Goal, Outcome
from sixthsense.navigation.path_planner import DrivingMap
from sixthsense.navigation.unseen_places import UnseenPlace


class Goals:
    """A task that drives to goals in turn: once, or again and again until the time is up on a tour that has a limit."""

    def __init__(self, goals: Array, config: Config) -> None:
        """Drive to `goals` (N, 2), world frame."""
        self.outcome: Outcome | None = None
        self.left: list[UnseenPlace] = []
        self.tours: list[Array] = []
        is_tour = config.task == "tour"
        places = [Goal(goal, 0.0) for goal in goals]
        self._rest = itertools.cycle(places) if is_tour and config.max_time is not None else iter(places)
        self._at_end: Outcome = "tour ended" if is_tour else "goal reached"
        self._goal = next(self._rest)

    def next(self, map_: DrivingMap, pose: Pose, event: Event) -> Goal | None:
        """The same goal until it is reached, then the next one; the task ends where there is no path or no progress."""
        if event == "arrived":
            following = next(self._rest, None)
            if following is None:
                self.outcome = self._at_end
            else:
                self._goal = following._replace()  # another one, even if it is the only goal of a tour
        elif event in ("no way", "stuck"):
            self.outcome = "goal unreachable" if event == "no way" else "stuck"
        return self._goal if self.outcome is None else None
