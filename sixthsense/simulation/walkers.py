"""People who walk in the simulated building: how they move, where their legs are, and whom they touch."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config, WorldConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.simulation.scene import BODY_M, Scene, walking_grid
from sixthsense.simulation.scene_files import ScriptedWalk

LEG_M = 0.06
"""radius of a leg"""

_SPEEDS = (0.5, 1.5)  # m/s, of those who walk about
_PAUSES_S = (0.0, 10.0)  # in a room
_HALF_HIPS_M = 0.1
_HALF_STEP_M = 0.2  # farthest that a leg swings before and behind the body
_DECIDE_S = 0.1  # time between two decisions
_KEEP_M, _BESIDE_M = 0.5, 0.1  # from the robot, in front of it and in passing
_PATIENCE_S = 5.0
_AHEAD_S, _AHEAD_M = 0.8, 0.4  # how far others and walls are looked out for
_ARRIVED_M = 0.15
_APART_M = 1.0  # two people at the start, or one and the robot
_TRIES = 5  # other goals of someone who cannot go on
_PARTED_M = 0.05  # gap after which the next touch is another one
_TURNS = np.radians([side * turn for turn in range(0, 81, 20) for side in (-1, 1)][1:])  # people keep to the right


Itinerary = Iterator[tuple[Array, float]]
"""the next goals (2,) of someone, and the pauses there in seconds, without end"""


def _rounds(walk: ScriptedWalk) -> Itinerary:
    """The way points of a scene after the first, again and again."""
    for k in itertools.count(1):
        k %= len(walk.points)
        yield np.array(walk.points[k]), walk.pause_s(k)


def _about(places: Array, rng: np.random.Generator) -> Itinerary:
    """Random ones of the places (N, 2)."""
    while True:
        yield places[rng.integers(len(places))], float(rng.uniform(*_PAUSES_S))


@dataclass(slots=True)
class _Walker:
    """Someone's plan."""

    itinerary: Itinerary
    speed: float
    rest_s: float
    """left of the pause"""
    goal: Array
    """(2,)"""
    way: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(N, 2) to the goal"""
    ahead: int = 0
    """the way point that is walked to; len(way): arrived"""
    pause_s: float = 0.0
    """at the goal"""
    stood_s: float = 0.0
    """time for which others have been in the way"""


class Walkers:
    """All people in a building. They see everything: each other, the robot and the walls."""

    def __init__(
        self, scene: Scene, config: WorldConfig, start: Pose, radius_m: float, rng: np.random.Generator
    ) -> None:
        """Those of the scene, and as many as are configured, seeded; the robot is a disc of `radius_m` at `start`.

        Raises InputError for more than there is room for.
        """
        self._grid, self._free = grid, free = walking_grid(scene)
        self._blind, self._contact_m = config.walkers_blind, radius_m + BODY_M
        around = grid.centres(np.argwhere(grid.reachable(free, start.position)))
        places = [np.array(walk.points[0]) for walk in scene.walkers]
        found = _places(around, [start.position, *places], config.walkers, rng)
        if len(found) < config.walkers:
            raise InputError(
                "world.walkers",
                f"found {config.walkers}",
                f"at most {len(found)}, for whom there is room in {scene.name}",
            )
        self._people = [_Walker(_rounds(w), w.speed, w.pause_s(0), np.array(w.points[0])) for w in scene.walkers]
        for place in found:
            speed, rest_s = float(rng.uniform(*_SPEEDS)), float(rng.uniform(*_PAUSES_S))
            self._people.append(_Walker(_about(around, rng), speed, rest_s, place))
        self.at = np.array([*places, *found]).reshape(-1, 2)
        """(N, 2) where they are"""
        self.headings = rng.uniform(-math.pi, math.pi, len(self.at))
        """(N,)"""
        self.touches = [0, 0]
        """touches by the robot's fault, and by a walker's"""
        self._velocities, self._walked_m = np.zeros_like(self.at), np.zeros(len(self.at))
        self._touching = np.zeros(len(self.at), dtype=np.bool_)
        self._due_s = 0.0

    @property
    def poses(self) -> Array:
        """(N, 3) x, y and heading of each body."""
        return np.column_stack([self.at, self.headings])

    def legs(self) -> Array:
        """(2N, 5) the legs as `core.ray_casting.NO_LEGS` says: one stands while the other one swings past it."""
        forward = np.stack([np.cos(self.headings), np.sin(self.headings)], axis=1)
        hips = _HALF_HIPS_M * np.stack([-forward[:, 1], forward[:, 0]], axis=1)
        part = self._walked_m / (2.0 * _HALF_STEP_M)
        falls = np.floor(part) % 2.0 == 0.0
        share = part % 1.0
        swing = np.where(falls, 1.0 - 2.0 * share, 2.0 * share - 1.0)[:, None]  # from 1 to -1 and back, of the left leg
        rate = np.where(falls, -1.0, 1.0)[:, None]
        rows = []
        for side in (1.0, -1.0):
            at = self.at + side * (hips + _HALF_STEP_M * swing * forward)
            velocities = (1.0 + side * rate) * self._velocities
            rows.append(np.column_stack([at, np.full(len(at), LEG_M), velocities]))
        return np.concatenate(rows)

    def step(self, before: Pose, after: Pose, dt: float) -> None:
        """Walk on for `dt` seconds, in which the robot has moved from `before` to `after`; count new touches."""
        self._due_s -= dt
        if self._due_s <= 0.0:
            self._due_s += _DECIDE_S
            for k in range(len(self._people)):
                self._decide(k, after.position)
        there = self.at + dt * self._velocities
        apart = there - after.position
        distance = np.maximum(np.hypot(apart[:, 0], apart[:, 1]), 1e-9)
        contact = distance < self._contact_m
        if contact.any():
            away = apart / distance[:, None]  # from the robot
            robot_in = away @ (after.position - before.position) / dt
            walker_in = -(away * self._velocities).sum(axis=1)
            new = contact & ~self._touching
            by_robot = int(np.count_nonzero(new & (robot_in > walker_in)))
            self.touches[0] += by_robot
            self.touches[1] += int(np.count_nonzero(new)) - by_robot
            there = np.where((contact & (walker_in > 0.0))[:, None], self.at, there)
        self._touching = distance < self._contact_m + _PARTED_M * self._touching
        self._walked_m += np.hypot(*(there - self.at).T)
        self.at = there

    def _decide(self, k: int, robot: Array) -> None:
        """Set the velocity of walker k until the next decision."""
        walker, here = self._people[k], self.at[k]
        self._velocities[k] = 0.0
        if walker.rest_s > 0.0:
            walker.rest_s -= _DECIDE_S
            return
        while walker.ahead < len(walker.way) and math.dist(walker.way[walker.ahead], here) < _ARRIVED_M:
            walker.ahead += 1
        if walker.ahead == len(walker.way):
            walker.rest_s = walker.pause_s
            walker.goal, walker.pause_s = next(walker.itinerary)
            self._set_out(k)
            return
        off = walker.way[walker.ahead] - here
        heading = math.atan2(off[1], off[0]) + _TURNS
        ways = np.stack([np.cos(heading), np.sin(heading)], axis=1)  # (T, 2)
        ahead_m = np.array([0.5, 1.0])[:, None, None] * min(_AHEAD_M, math.hypot(off[0], off[1]))
        open_ways = self._grid.at(self._free, here + ahead_m * ways).all(axis=0)
        if not open_ways.any():
            self._set_out(k)
            return
        clear = open_ways & self._passes_others(k, walker.speed * ways)
        if not self._blind:
            touch = self._would_touch(here, ways, robot)
            clear &= ~(touch | touch[0])  # no way around at once: they stop for the robot
        if not clear.any():
            walker.stood_s += _DECIDE_S
            if walker.stood_s >= _PATIENCE_S:
                walker.stood_s = 0.0
                self._set_out(k, self._in_the_way(k, robot))
            return
        walker.stood_s = 0.0
        best = int(np.argmax(clear))
        self._velocities[k] = walker.speed * ways[best]
        self.headings[k] = math.atan2(ways[best][1], ways[best][0])

    def _passes_others(self, k: int, velocities: Array) -> NDArray[np.bool_]:
        """(T,) which of the velocities (T, 2) of walker k lead it soon into no other, or away from one."""
        others = np.arange(len(self.at)) != k
        off = (self.at[others] - self.at[k])[None]  # (1, M, 2)
        relative = self._velocities[others][None] - velocities[:, None]  # (T, M, 2)
        closing = (off * relative).sum(axis=2)
        time_s = np.clip(-closing / np.maximum((relative**2).sum(axis=2), 1e-12), 0.0, _AHEAD_S)
        nearest = np.linalg.norm(off + time_s[..., None] * relative, axis=2)
        return np.asarray(((nearest >= 2.0 * BODY_M) | (closing >= 0.0)).all(axis=1))

    def _would_touch(self, here: Array, ways: Array, robot: Array) -> NDArray[np.bool_]:
        """(T,) along which ways (T, 2) the robot is in the way, and as near as is kept from it."""
        off = robot - here
        ahead, aside = ways @ off, ways[:, 0] * off[1] - ways[:, 1] * off[0]
        # Of the chord of a disc that is wider than a contact.
        half_sq = (self._contact_m + _BESIDE_M) ** 2 - aside**2
        return np.asarray((half_sq > 0.0) & (ahead > 0.0) & (ahead < _KEEP_M + np.sqrt(np.maximum(half_sq, 0.0))))

    def _in_the_way(self, k: int, robot: Array) -> list[tuple[Array, float]]:
        """Discs around the others and the robot that walker k keeps off; not nearer than now, where it is too near."""
        discs = [(place, 2.0 * BODY_M) for j, place in enumerate(self.at) if j != k]
        discs.append((robot, self._contact_m + 2.0 * _BESIDE_M))
        return [(place, min(radius_m, math.dist(place, self.at[k]))) for place, radius_m in discs]

    def _set_out(self, k: int, avoid: Sequence[tuple[Array, float]] = ()) -> None:
        """Have walker k take the shortest way to its goal, or to one of the next goals if none leads there."""
        walker = self._people[k]
        for _ in range(_TRIES):
            way = self._grid.way(self._free, self.at[k], walker.goal, avoid)
            if way is not None:
                walker.way, walker.ahead = way, 1
                return
            walker.goal, walker.pause_s = next(walker.itinerary)


def walkers_of(scene: Scene, config: Config, start: Pose, radius_m: float) -> Walkers | None:
    """The people in a building; None without any."""
    if not scene.walkers and not config.world.walkers:
        return None
    return Walkers(scene, config.world, start, radius_m, random_streams(config.seed).walkers)


def _places(free: Array, taken: Sequence[Array], count: int, rng: np.random.Generator) -> list[Array]:
    """Up to `count` random places among `free` (N, 2), apart from each other and from those that are taken."""
    found: list[Array] = []
    left = free[rng.permutation(len(free))] if count else free[:0]
    for place in taken:
        left = left[np.hypot(*(left - place).T) >= _APART_M]
    while len(found) < count and len(left):
        found.append(left[0])
        left = left[np.hypot(*(left - left[0]).T) >= _APART_M]
    return found
