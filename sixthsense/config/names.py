"""Allowed names of estimators and planners, to which a user can add."""

from __future__ import annotations

import re
from collections.abc import Iterator

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,79}")


class Names:
    """Shipped names, in order, and those that were registered in this process."""

    def __init__(self, *shipped: str) -> None:
        self.shipped = shipped
        self._own: list[str] = []

    def add(self, name: str) -> None:
        """Allow one more name, or the same again; ValueError for a shipped or an invalid one."""
        if name in self.shipped or not _NAME.fullmatch(name):
            raise ValueError(
                f"name: found {name!r}, allowed: letters, digits, dot, - and _, a letter first, "
                f"and none of {', '.join(self.shipped)}"
            )
        if name not in self._own:
            self._own.append(name)

    def __contains__(self, name: object) -> bool:
        return name in self.shipped or name in self._own

    def __iter__(self) -> Iterator[str]:
        return iter((*self.shipped, *self._own))

    def __str__(self) -> str:
        return ", ".join(self)


ESTIMATORS = Names("ekf", "ekf-fej", "ekf-oc", "ekf-invariant", "isam2")
PLANNERS = Names("astar", "rrtstar")

FILTERS = ("ekf", "ekf-fej", "ekf-oc", "ekf-invariant")
"""shipped estimators that do not keep the poses of all keyframes"""
KEEP_POSES = "with isam2, which keeps the poses of all keyframes"
"""of messages about the front end of scans"""
NEEDS_FILTER = "a shipped estimator, or one with the methods of Filter"
"""of messages about parameters that are estimated with the pose"""

OF_THE_ROBOT = ("scene", "task", "goal", "tour", "start", "region", "planner", "rrtstar", "follow", "explore", "world")
"""fields and sections of the configuration that a replay refuses: they are of a robot that is driven or simulated"""
