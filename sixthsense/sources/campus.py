"""A campus drawn from a few numbers: blocks of rooms and halls with furniture, between corridors that cross.

A file of its walls would have a megabyte; a scene states the numbers instead.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from sixthsense.config.section import ConfigError, Range, Section
from sixthsense.core.geometry import Array
from sixthsense.sources.scene_files import Point

Wall = list[Point]

_MOST_BLOCKS = 400
_DOOR_M, _HALL_DOOR_M = (0.9, 1.2), 2.0
_BAND_M = (5.0, 7.0)  # depth of the rooms along two sides of a block
_ROOM_M = (4.5, 6.5)  # their width, about
_PILLAR_M, _PILLARS_APART_M = 0.6, 6.0
_PIECE_M, _PIECE_CLEAR_M = (0.5, 1.6), 1.0  # furniture, and its distance from walls: no door is blocked


@dataclass(frozen=True)
class Campus(Section):
    """The numbers that a campus is drawn from: the table `campus` of a scene."""

    blocks: tuple[Annotated[int, Range(1, _MOST_BLOCKS)], Annotated[int, Range(1, _MOST_BLOCKS)]]
    """along x and y"""
    block_m: Annotated[float, Range(20.0, 1e6)]
    """side of a block"""
    corridor_m: Annotated[float, Range(1.5, 1e6)]
    """width of the corridors around the blocks"""
    halls: Annotated[float, Range(0.0, 1.0)]
    """share of the blocks that are a hall with pillars"""
    furniture: Annotated[float, Range(0.0, 3.0)]
    """mean number of pieces in a room"""
    seed: Annotated[int, Range(0)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.blocks[0] * self.blocks[1] > _MOST_BLOCKS:
            found = f"{self.blocks[0]} x {self.blocks[1]}"
            raise ConfigError(f"blocks: found {found}, allowed: at most {_MOST_BLOCKS} in all")


def campus_walls(campus: Campus) -> list[Wall]:
    """The walls, from (0, 0) on; one seed is one campus."""
    rng = np.random.default_rng(campus.seed)
    pitch = campus.block_m + campus.corridor_m
    size = np.array(campus.blocks) * pitch + campus.corridor_m
    walls = _box((0.0, 0.0), (float(size[0]), float(size[1])))
    for i in range(campus.blocks[0]):
        for j in range(campus.blocks[1]):
            low = campus.corridor_m + pitch * np.array([i, j], dtype=np.float64)
            walls += _hall(low, campus, rng) if rng.random() < campus.halls else _rooms(low, campus, rng)
    return walls


def _rooms(low: Array, campus: Campus, rng: np.random.Generator) -> list[Wall]:
    """A block of rooms: a row along its lower and its upper side, and between them two on either hand."""
    side = campus.block_m
    bottom, top = rng.uniform(*_BAND_M, 2)
    middle, across = rng.uniform(0.45, 0.55, 2)
    walls: list[Wall] = []
    for depth, outer, inner in ((bottom, 0.0, bottom), (top, side, side - top)):
        count = round(side / rng.uniform(*_ROOM_M))
        edges = np.concatenate([[0.0], np.arange(1, count) + rng.uniform(-0.1, 0.1, count - 1), [count]]) * side / count
        walls.append([(0.0, inner), (side, inner)])
        for left, right in itertools.pairwise(edges):
            walls += _with_door((left, outer), (right, outer), _DOOR_M, rng)
            walls += _furniture((left, min(outer, inner)), (right - left, depth), campus.furniture, rng)
        walls += [[(float(x), outer), (float(x), inner)] for x in edges]
    height, x = side - top - bottom, middle * side
    y = bottom + across * height
    walls += [[(x, bottom), (x, side - top)], [(0.0, y), (side, y)]]
    for below, above in ((bottom, y), (y, side - top)):
        walls += _with_door((0.0, below), (0.0, above), _DOOR_M, rng) + _with_door(
            (side, below), (side, above), _DOOR_M, rng
        )
        walls += _furniture((0.0, below), (x, above - below), campus.furniture, rng)
        walls += _furniture((x, below), (side - x, above - below), campus.furniture, rng)
    return _moved(walls, low)


def _hall(low: Array, campus: Campus, rng: np.random.Generator) -> list[Wall]:
    """A hall with a wide door in each side and rows of pillars."""
    side = campus.block_m
    corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)]
    walls: list[Wall] = []
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        walls += _with_door(a, b, (_HALL_DOOR_M, _HALL_DOOR_M), rng)
    count = int(side / _PILLARS_APART_M) - 1
    first = 0.5 * (side - (count - 1) * _PILLARS_APART_M - _PILLAR_M)
    for i in range(count):
        for j in range(count):
            x, y = first + _PILLARS_APART_M * i, first + _PILLARS_APART_M * j
            walls += _box((x, y), (_PILLAR_M, _PILLAR_M))
    return _moved(walls, low)


def _with_door(a: Point, b: Point, width_m: tuple[float, float], rng: np.random.Generator) -> list[Wall]:
    """A wall from a to b with a door, away from its ends."""
    begin, there = np.array(a), np.array(b) - np.array(a)
    length, width = float(np.hypot(*there)), float(rng.uniform(*width_m))
    at = float(rng.uniform(0.5, length - 0.5 - width))
    ends = [begin, begin + at / length * there, begin + (at + width) / length * there, begin + there]
    points = [(float(x), float(y)) for x, y in ends]
    return [points[:2], points[2:]]


def _furniture(low: Point, size: Sequence[float], mean: float, rng: np.random.Generator) -> list[Wall]:
    """Pieces of furniture in a room, away from its walls and from each other; those without a place are left out."""
    walls: list[Wall] = []
    kept: list[tuple[Array, Array]] = []
    for _ in range(rng.poisson(mean)):
        piece = rng.uniform(*_PIECE_M, 2)
        room = np.asarray(size) - piece - 2.0 * _PIECE_CLEAR_M
        at = np.asarray(low) + _PIECE_CLEAR_M + rng.random(2) * np.maximum(room, 0.0)
        gaps = [np.maximum(at - (p + s), p - (at + piece)).max() for p, s in kept]
        if (room > 0.0).all() and min(gaps, default=np.inf) > _PIECE_CLEAR_M:
            kept.append((at, piece))
            walls += _box((float(at[0]), float(at[1])), (float(piece[0]), float(piece[1])))
    return walls


def _box(low: Point, size: Point) -> list[Wall]:
    (x, y), (w, h) = low, size
    corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
    return [[a, b] for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]


def _moved(walls: list[Wall], by: Array) -> list[Wall]:
    x, y = float(by[0]), float(by[1])
    return [[(float(ax) + x, float(ay) + y), (float(bx) + x, float(by_) + y)] for (ax, ay), (bx, by_) in walls]
