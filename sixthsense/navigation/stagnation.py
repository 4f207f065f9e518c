"""Whether an exploring robot gets nowhere: it is stuck, or ways to its views are blocked again and again."""

from __future__ import annotations

from sixthsense.navigation.exploration_states import Event
from sixthsense.navigation.path_driver import PATIENT_TURNS

_BLOCKED_WAYS = 6  # without anything new to see; explorations that go on have up to three in a row
_NEW_M2 = 0.05  # seen since: less may be noise at the edges of obstacles


class Stagnation:
    """Counts what happens without an arrival, a target seen, or much that is new."""

    def __init__(self, people: bool | None = None) -> None:
        """Count from nothing; `people` is whether any are expected, for whom the robot waits."""
        self._people = people
        self._stuck = False
        self._blocked_ways = 0
        self._seen_m2 = self._waited_m2 = 0.0
        self._waits = 0

    def event(self, event: Event) -> Event:
        """The event itself, or "stuck again" if the robot has not arrived anywhere since it was stuck."""
        if event in ("arrived", "target seen"):
            self._blocked_ways = 0
        if event == "arrived":
            self._stuck = False
        elif event == "stuck" and self._stuck:
            return "stuck again"
        self._stuck |= event == "stuck"
        return event

    def blocks_for_good(self, seen_m2: float) -> bool:
        """Count a blocked way, when `seen_m2` have been seen in all; whether so many were that it should be given up.

        Noise may open one of two gaps as often as the other. The robot then turns from one to the other for ever.
        """
        if seen_m2 > self._seen_m2 + _NEW_M2:
            self._blocked_ways = 0
        self._blocked_ways += 1
        self._seen_m2 = max(seen_m2, self._seen_m2)
        if self._blocked_ways <= _BLOCKED_WAYS:
            return False
        self._blocked_ways = 0
        return True

    def may_wait(self, seen_m2: float) -> bool:
        """Count a wait for people to go, when `seen_m2` have been seen in all; whether patience is left for it."""
        if not self._people:
            return False
        if seen_m2 > self._waited_m2 + _NEW_M2:
            self._waits = 0
        self._waits += 1
        self._waited_m2 = max(seen_m2, self._waited_m2)
        return self._waits <= PATIENT_TURNS
