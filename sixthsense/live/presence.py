"""Whether a sensor still sends."""

from __future__ import annotations

SILENT_NS = 400_000_000
"""A sensor that has sent nothing for this long is silent where the robot is driven: it must not drive on."""
LONG_SILENT_NS = 2_000_000_000
"""The same where it is only listened to."""


class Presence:
    """Tells when a sensor falls silent, and when it is back."""

    def __init__(self, name: str, now_ns: int, silent_ns: int) -> None:
        """The sensor of this name has last been heard now; after `silent_ns` without a message it is silent."""
        self.is_silent = False
        self._silent_ns = silent_ns
        self.name, self._heard_ns = name, now_ns

    def heard(self, now_ns: int) -> float | None:
        """Take in a message; how long the sensor had been silent, seconds, if it had been."""
        silent_s, self._heard_ns = 1e-9 * (now_ns - self._heard_ns), now_ns
        was_silent, self.is_silent = self.is_silent, False
        return silent_s if was_silent else None

    def falls_silent(self, now_ns: int) -> bool:
        """Whether the sensor has fallen silent since the last call."""
        was_silent, self.is_silent = self.is_silent, now_ns - self._heard_ns > self._silent_ns
        return self.is_silent and not was_silent
