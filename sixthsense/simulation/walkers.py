"""People who walk in the simulated building: how they move, where their legs are, and whom they touch."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.simulation.scene import BODY_M, Scene, walking_grid
from sixthsense.simulation.scene_files import ScriptedWalk

LEG_M = 0.06
"""radius of a leg"""

_SPEEDS = (0.5, 1.5)  # m/s, of those who walk about
_LONGEST_PAUSE_S = 10.0  # in a room
_HALF_HIPS_M = 0.1
_HALF_STEP_M = 0.2  # farthest that a leg swings before and behind the body
_DECIDE_S = 0.1  # time between two decisions
_KEEP_M, _BESIDE_M = 0.5, 0.1  # from the robot, in front of it and in passing
_PATIENCE_S = 5.0
_AHEAD_S, _AHEAD_M = 0.8, 0.4  # how far others and walls are looked out for
_ARRIVED_M = 0.15
_APART_M = 1.0  # two people at the start, or one and the robot
_PARTED_M = 0.05  # gap after which the next touch is another one
_TURNS = np.radians([side * turn for turn in range(0, 81, 20) for side in (-1, 1)][1:])  # people keep to the right


Itinerary = Iterator[tuple[Array, float]]
"""the next goals (2,) of someone, and the pauses there in seconds, without end"""


def _rounds(walk: ScriptedWalk) -> Itinerary:
    """The way points of a scene after the first, again and again."""
    for k in itertools.islice(itertools.cycle(range(len(walk.points))), 1, None):
        yield np.array(walk.points[k]), walk.pause_s(k)


def _about(places: Array, rng: np.random.Generator) -> Itinerary:
    """Random ones of the places (N, 2)."""
    while True:
        yield places[rng.integers(len(places))], float(rng.uniform(0.0, _LONGEST_PAUSE_S))


@dataclass(slots=True)
class _Walker:
    """Someone's plan."""

    itinerary: Itinerary
    speed: float
    pause_s: float
    """at the next goal"""
    way: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(N, 2) what is left of the way there"""
    rest_s: float = 0.0
    """left of a pause"""
    stood_s: float = 0.0
    """time for which walls or others have been in the way"""


class Walkers:
    """All people in a building. They see everything: each other, the robot and the walls."""

    def __init__(self, scene: Scene, config: Config, start: Pose, radius_m: float) -> None:
        """Those of the scene, and as many as are configured, seeded; the robot is a disc of `radius_m` at `start`.

        Raises InputError for more than there is room for.
        """
        rng, count = random_streams(config.seed).walkers, config.world.walkers
        self._grid, self._free = grid, free = walking_grid(scene)
        self._blind, self._contact_m = config.world.walkers_blind, radius_m + BODY_M
        around = grid.centres(np.argwhere(grid.reachable(free, start.position)))
        places = [np.array(walk.points[0]) for walk in scene.walkers]
        found = _places(around, [start.position, *places], count, rng)
        if len(found) < count:
            allowed = f"at most {len(found)}, for whom there is room in {scene.name}"
            raise InputError("world.walkers", f"found {count}", allowed)
        self._people = [_Walker(_rounds(walk), walk.speed, walk.pause_s(0)) for walk in scene.walkers]
        for _ in found:
            pause_s = float(rng.uniform(0.0, _LONGEST_PAUSE_S))
            self._people.append(_Walker(_about(around, rng), float(rng.uniform(*_SPEEDS)), pause_s))
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
        phase = (self._walked_m / (2.0 * _HALF_STEP_M) % 2.0)[:, None]
        # Of the left leg; the swing is -1 to 1.
        swing, rate = 2.0 * np.abs(phase - 1.0) - 1.0, np.where(phase < 1.0, -1.0, 1.0)
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
        off = there - after.position
        distance = np.hypot(*off.T)
        contact = distance < self._contact_m
        robot_in = off @ (after.position - before.position) / dt
        walker_in = -(off * self._velocities).sum(axis=1)
        new = contact & ~self._touching
        self.touches[0] += int(np.count_nonzero(new & (robot_in > walker_in)))
        self.touches[1] += int(np.count_nonzero(new & (robot_in <= walker_in)))
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
        while len(walker.way) and math.dist(walker.way[0], here) < _ARRIVED_M:
            walker.way = walker.way[1:]
        if not len(walker.way):
            walker.rest_s = walker.pause_s
            self._set_out(k)
            return
        off = walker.way[0] - here
        heading = math.atan2(off[1], off[0]) + _TURNS
        ways = np.stack([np.cos(heading), np.sin(heading)], axis=1)  # (T, 2)
        ahead_m = np.array([0.5, 1.0])[:, None, None] * min(_AHEAD_M, math.hypot(off[0], off[1]))
        clear = self._grid.at(self._free, here + ahead_m * ways).all(axis=0)
        clear &= self._passes_others(k, walker.speed * ways)
        if not self._blind:
            touch = self._would_touch(here, ways, robot)
            clear &= ~(touch | touch[0])  # no way around at once: they stop for the robot
        if clear.any():
            walker.stood_s, best = 0.0, int(np.argmax(clear))
            self._velocities[k], self.headings[k] = walker.speed * ways[best], heading[best]
            return
        walker.stood_s += _DECIDE_S
        if walker.stood_s >= _PATIENCE_S:
            self._set_out(k)

    def _set_out(self, k: int) -> None:
        """Have walker k take the shortest way to its next goal."""
        walker = self._people[k]
        goal, walker.pause_s = next(walker.itinerary)
        walker.way, walker.stood_s = self._grid.way(self._free, self.at[k], goal), 0.0

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


def _places(free: Array, taken: Sequence[Array], count: int, rng: np.random.Generator) -> list[Array]:
    """Up to `count` random places among `free` (N, 2), apart from each other and from those that are taken."""
    found = [*taken]
    for place in free[rng.permutation(len(free))]:
        if len(found) == len(taken) + count:
            break
        if (np.hypot(*(np.array(found) - place).T) >= _APART_M).all():
            found.append(place)
    return found[len(taken) :]
