"""Worlds with walls that no scene of this repository has: eight families, a new world for every seed.

A building of 16 x 10 m with a corridor and rooms on both sides is drawn at random; the family says what its walls are
like. All lengths in metres, all randomness from the generator passed in.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sixthsense.core.geometry import Array, rotation
from sixthsense.simulation.scene import Scene

RADIUS_M = 0.18
_WIDTH, _HEIGHT = 16.0, 10.0
_LEAST_ROOM, _LARGEST_ROOM = 3.0, 6.1
_SEGMENT_M = 0.05  # of curves

Stretch = tuple[Array, Array]
"""A nominal wall without openings, from one point (2,) to another."""
Texture = Callable[[Array, Array, np.random.Generator], Array]
"""From the ends (2,) of a stretch to the corners (K, 2) of the wall that stands there."""


def generated_world(family: str, seed: int) -> Scene:
    """The scene of a family and a seed, without start and tour; KeyError for an unknown family."""
    rng = np.random.default_rng([seed, sorted(FAMILIES).index(family)])
    walls, glass = FAMILIES[family](rng)
    region = (-0.5, -0.5, _WIDTH + 0.5, _HEIGHT + 0.5)
    return Scene(f"{family}-{seed}", walls, None, RADIUS_M, None, (), region, glass=glass)


def _building(rng: np.random.Generator, door: tuple[float, float] = (0.85, 1.2)) -> tuple[list[Stretch], list[Stretch]]:
    """Outer and inner stretches of a building with a corridor; every room has a door, some a second one."""
    low = rng.uniform(3.3, 4.2)
    high = low + rng.uniform(1.5, 2.2)
    corners = [np.array(p) for p in ((0.0, 0.0), (_WIDTH, 0.0), (_WIDTH, _HEIGHT), (0.0, _HEIGHT))]
    outer = list(itertools.pairwise([*corners, corners[0]]))
    inner: list[Stretch] = []
    for side, far in ((low, 0.0), (high, _HEIGHT)):
        bounds = [0.0]
        while _WIDTH - bounds[-1] > _LARGEST_ROOM:
            room = rng.uniform(_LEAST_ROOM, min(_LARGEST_ROOM, _WIDTH - bounds[-1] - _LEAST_ROOM))
            bounds.append(bounds[-1] + room)
        bounds.append(_WIDTH)
        openings = [_opening(rng, a, b, door) for a, b in itertools.pairwise(bounds)]
        inner += [
            (np.array([a, side]), np.array([b, side]))
            for a, b in zip([0.0, *(o[1] for o in openings)], [*(o[0] for o in openings), _WIDTH], strict=True)
        ]
        for x in bounds[1:-1]:
            begin, end = sorted((side, far))
            if rng.random() < 0.4:
                first, second = _opening(rng, begin, end, door)
                inner += [(np.array([x, begin]), np.array([x, first])), (np.array([x, second]), np.array([x, end]))]
            else:
                inner.append((np.array([x, begin]), np.array([x, end])))
    return outer, inner


def _opening(rng: np.random.Generator, begin: float, end: float, door: tuple[float, float]) -> tuple[float, float]:
    """Where a door begins and ends along a wall."""
    width = rng.uniform(*door)
    first = rng.uniform(begin + 0.5, end - 0.5 - width)
    return first, first + width


def _segments(corners: Array) -> Array:
    """(K - 1, 2, 2) segments between corners (K, 2)."""
    return np.stack([corners[:-1], corners[1:]], axis=1)


def closed(corners: ArrayLike) -> Array:
    """(K, 2, 2) sides of a polygon with corners (K, 2)."""
    points = np.asarray(corners, dtype=np.float64)
    return _segments(np.concatenate([points, points[:1]]))


def _textured(rng: np.random.Generator, texture: Texture) -> Array:
    """(N, 2, 2) walls of a building all of whose stretches have the same texture."""
    outer, inner = _building(rng)
    return np.concatenate([_segments(texture(a, b, rng)) for a, b in outer + inner])


def _bent(a: Array, b: Array, rng: np.random.Generator) -> Array:
    """A wall that bends by 0.5 to 10 degrees every 1 to 4 m."""
    length = float(np.linalg.norm(b - a))
    for _ in range(100):
        pieces = [rng.uniform(1.0, 4.0)]
        while sum(pieces) < length - 1.0:
            pieces.append(rng.uniform(1.0, 4.0))
        turns = np.radians(np.exp(rng.uniform(math.log(0.5), math.log(10.0), len(pieces))))
        headings = np.cumsum(turns * rng.choice([-1.0, 1.0], len(pieces)))
        steps = np.array(pieces)[:, None] * np.column_stack([np.cos(headings), np.sin(headings)])
        corners = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        # Turned and scaled to begin and end where the nominal wall does; that keeps the angles.
        chord = corners[-1]
        scale = length / float(np.linalg.norm(chord))
        along = math.atan2(b[1] - a[1], b[0] - a[0]) - math.atan2(chord[1], chord[0])
        level = scale * corners @ rotation(-math.atan2(chord[1], chord[0])).T
        if np.abs(level[:, 1]).max() <= 0.3:
            return np.asarray(a + scale * corners @ rotation(along).T)
    return np.stack([a, b])


def _stepped(a: Array, b: Array, rng: np.random.Generator) -> Array:
    """A wall with a step of 1 to 8 cm every 0.8 to 3 m."""
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    across = np.array([-along[1], along[0]])
    corners, place, off = [a], 0.0, 0.0
    while (place := place + rng.uniform(0.8, 3.0)) < length - 0.4:
        step = rng.uniform(0.01, 0.08) * rng.choice([-1.0, 1.0])
        step = -step if abs(off + step) > 0.16 else step
        corners += [a + place * along + off * across, a + place * along + (off + step) * across]
        off += step
    return np.array([*corners, b + off * across])


def _curved(a: Array, b: Array, rng: np.random.Generator) -> Array:
    """A wall that is an arc, most often; its height is up to a tenth of its length."""
    length = float(np.linalg.norm(b - a))
    if length < 1.0 or rng.random() < 0.3:
        return np.stack([a, b])
    height = min(0.5, rng.uniform(0.02, 0.1) * length) * rng.choice([-1.0, 1.0])
    along = (b - a) / length
    across = np.array([-along[1], along[0]])
    t = np.linspace(-1.0, 1.0, max(3, math.ceil(length / _SEGMENT_M)) + 1)
    half = math.asin(4.0 * height * length / (length**2 + 4.0 * height**2))  # half of the angle of the arc
    radius = 0.5 * length / math.sin(half)
    x, y = radius * np.sin(half * t), radius * (np.cos(half * t) - math.cos(half))
    return np.asarray(0.5 * (a + b) + x[:, None] * along + y[:, None] * across)


def _thick(rng: np.random.Generator) -> tuple[Array, Array]:
    """Inner walls with two faces 5 to 30 cm apart."""
    outer, inner = _building(rng)
    walls = [np.array([wall]) for wall in outer]
    for a, b in inner:
        along = (b - a) / np.linalg.norm(b - a)
        half = 0.5 * rng.uniform(0.05, 0.3) * np.array([-along[1], along[0]])
        walls.append(closed(np.array([a - half, b - half, b + half, a + half])))
    return np.concatenate(walls), _NONE


def box(centre: Array, size: Array, turn: float = 0.0) -> Array:
    """(4, 2, 2) sides of a rectangle."""
    half = 0.5 * size * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return closed(centre + half @ rotation(turn).T)


def _scattered(rng: np.random.Generator, count: int) -> Array:
    """(count, 2) places in the building."""
    return rng.uniform((0.4, 0.4), (_WIDTH - 0.4, _HEIGHT - 0.4), (count, 2))


def _cluttered(rng: np.random.Generator) -> tuple[Array, Array]:
    """Boxes of 5 to 60 cm and legs of tables, everywhere."""
    walls = [_textured(rng, lambda a, b, _: np.stack([a, b]))]
    for centre in _scattered(rng, 40):
        walls.append(box(centre, rng.uniform(0.05, 0.6, 2), rng.uniform(0.0, math.pi)))
    for centre in _scattered(rng, 12):
        turn, size = rng.uniform(0.0, math.pi), rng.uniform(0.3, 0.8, 2)
        for corner in (0.5 * size * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])) @ rotation(turn).T:
            walls.append(box(centre + corner, np.full(2, 0.04), turn))
    return np.concatenate(walls), _NONE


def _pillared(rng: np.random.Generator) -> tuple[Array, Array]:
    """A hall with round and square pillars."""
    outer, _ = _building(rng)
    walls = [np.array(outer)]
    for k, centre in enumerate(_scattered(rng, 16)):
        if k % 2:
            walls.append(box(centre, np.full(2, rng.uniform(0.2, 0.6)), rng.uniform(0.0, math.pi)))
        else:
            angles = np.linspace(0.0, 2.0 * math.pi, 32, endpoint=False)
            walls.append(closed(centre + rng.uniform(0.1, 0.4) * np.column_stack([np.cos(angles), np.sin(angles)])))
    return np.concatenate(walls), _NONE


def _glazed(rng: np.random.Generator) -> tuple[Array, Array]:
    """A third of all walls is glass: it stops the robot and returns nothing."""
    outer, inner = _building(rng)
    walls, glass = [], []
    for a, b in outer + inner:
        length = float(np.linalg.norm(b - a))
        places = [0.0]
        while places[-1] < length:
            places.append(min(length, places[-1] + rng.uniform(0.5, 2.0)))
        for first, second in itertools.pairwise(places):
            piece = np.stack([a + first / length * (b - a), a + second / length * (b - a)])
            (glass if rng.random() < 0.33 else walls).append(piece)
    return np.array(walls), np.array(glass)


def _narrow(rng: np.random.Generator) -> tuple[Array, Array]:
    """Doors of 0.62 to 0.75 m."""
    outer, inner = _building(rng, door=(0.62, 0.75))
    return np.array(outer + inner), _NONE


LASERS: dict[str, dict[str, Any]] = {
    "full circle": {},
    "quarter": {"fov": 0.5 * math.pi, "beams": 90},
    "half": {"fov": math.pi, "beams": 180},
    "short": {"max_range": 3.0},
    "slow": {"period_ticks": 10},
    "sparse": {"beams": 60},
    "sweeping": {"sweep_s": 0.1},
}
"""what a robot's laser is like that is not the default"""
_ODD_FAMILIES = "bends", "steps", "curves", "thick", "clutter", "pillars", "doors"


def odd_robot(seed: int) -> tuple[str, str, dict[str, Any]]:
    """A family of worlds, a name of `LASERS`, and the configuration of a robot with it, of any size and speed."""
    rng = np.random.default_rng([seed, 63])
    family, laser = str(rng.choice(_ODD_FAMILIES)), sorted(LASERS)[seed % len(LASERS)]
    robot = {"radius": float(rng.uniform(0.12, 0.35)), "speed": float(rng.uniform(0.3, 1.0))}
    return family, laser, {"robot": robot, "laser": LASERS[laser]}


_NONE = np.zeros((0, 2, 2))

FAMILIES: dict[str, Callable[[np.random.Generator], tuple[Array, Array]]] = {
    "bends": lambda rng: (_textured(rng, _bent), _NONE),
    "steps": lambda rng: (_textured(rng, _stepped), _NONE),
    "curves": lambda rng: (_textured(rng, _curved), _NONE),
    "thick": _thick,
    "clutter": _cluttered,
    "pillars": _pillared,
    "glass": _glazed,
    "doors": _narrow,
}
"""From a generator of random numbers to walls (N, 2, 2) and glass (G, 2, 2)."""
