"""A person's walk that a scene states: `[[walkers]]` with way points, a speed and pauses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sixthsense.config.section import shown
from sixthsense.core.geometry import Array
from sixthsense.sources.scene_fields import Point, Region, check_keys, read_list, read_point, read_positive
from sixthsense.sources.scene_names import SceneError
from sixthsense.sources.walking_space import BODY_M, WalkingSpace

_KEYS = ("points", "speed", "pauses")
_FASTEST = 3.0  # m/s
_USUAL = 1.0
_LONGEST_PAUSE_S = 1e6
_MOST = 200


@dataclass(frozen=True, slots=True)
class ScriptedWalk:
    """Way points that someone visits in this order again and again, each by the shortest way."""

    points: tuple[Point, ...]
    speed: float
    """m/s"""
    pauses_s: tuple[float, ...]
    """at each way point"""


def read_walks(tables: list[Any]) -> tuple[ScriptedWalk, ...]:
    """The tables `walkers` of a scene; SceneError that names the field."""
    if len(tables) > _MOST:
        raise SceneError(f"walkers: found {len(tables)}, allowed: at most {_MOST}")
    return tuple(_walk(f"walkers, entry {k}", table) for k, table in enumerate(tables, 1))


def _walk(where: str, table: Any) -> ScriptedWalk:
    if not isinstance(table, dict):
        raise SceneError(f"{where}: found {shown(table)}, allowed: a table with {', '.join(_KEYS)}")
    check_keys(f"{where}, ", table, _KEYS, ("points",))
    points = tuple(
        read_point(f"{where}, point {k}", p) for k, p in enumerate(read_list(f"{where}, points", table["points"]), 1)
    )
    if not points:
        raise SceneError(f"{where}, points: found none, allowed: at least one way point")
    speed = read_positive(f"{where}, speed", table.get("speed", _USUAL), "m/s")
    if speed > _FASTEST:
        raise SceneError(f"{where}, speed: found {speed:g}, allowed: above 0 to {_FASTEST:g} m/s")
    pauses = read_list(f"{where}, pauses", table.get("pauses", [0.0] * len(points)))
    is_time = [isinstance(p, (int, float)) and not isinstance(p, bool) and 0.0 <= p <= _LONGEST_PAUSE_S for p in pauses]
    if len(pauses) != len(points) or not all(is_time):
        allowed = f"a time of at least 0 s for each of the {len(points)} way points"
        raise SceneError(f"{where}, pauses: found {shown(pauses)}, allowed: {allowed}")
    return ScriptedWalk(points, speed, tuple(map(float, pauses)))


def check_walks(walks: Sequence[ScriptedWalk], solid: Array, region: Region) -> None:
    """Raise SceneError for a way point in a wall or outside the region, and for two between which no way leads."""
    if not walks:
        return
    space = WalkingSpace(solid, region)
    for k, walk in enumerate(walks, 1):
        points = np.array(walk.points)
        for number, (point, free) in enumerate(zip(points, space.is_free(points), strict=True), 1):
            if not free:
                found = f"({point[0]:g}, {point[1]:g}), in a wall or outside the region"
                allowed = f"a place with room for a body of {BODY_M:g} m"
                raise SceneError(f"walkers, entry {k}, point {number}: found {found}, allowed: {allowed}")
        for number, (a, b) in enumerate(zip(points, np.roll(points, -1, axis=0), strict=True), 1):
            if space.way(a, b) is None:
                there = f"from ({a[0]:g}, {a[1]:g}) to ({b[0]:g}, {b[1]:g})"
                raise SceneError(
                    f"walkers, entry {k}, point {number}: found no way {there}, allowed: points that ways join"
                )
