"""Whether a sensor still sends."""

from __future__ import annotations

SILENT_NS = 400_000_000
"""A sensor that has sent nothing for this long is silent: the robot must not drive."""


class Presence:
    """Tells when a sensor falls silent, and when it is back."""

    def __init__(self, name: str, now_ns: int) -> None:
        """The sensor of this name has last been heard now."""
        self.is_silent = False
        self._name, self._heard_ns = name, now_ns

    def heard(self, now_ns: int) -> str | None:
        """Take in a message; a note if the sensor had been silent."""
        silent_s, self._heard_ns = 1e-9 * (now_ns - self._heard_ns), now_ns
        if not self.is_silent:
            return None
        self.is_silent = False
        return f"{self._name} sends again, after {silent_s:.1f} s"

    def check(self, now_ns: int) -> str | None:
        """A note if the sensor has fallen silent since the last call."""
        if self.is_silent or now_ns - self._heard_ns <= SILENT_NS:
            return None
        self.is_silent = True
        return f"{self._name} is silent"
