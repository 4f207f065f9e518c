"""A campus drawn from a few numbers: blocks of rooms and halls with furniture, between corridors that cross.

A file of its walls would have a megabyte; a scene states the numbers instead.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from sixthsense.config.errors import InputError
from sixthsense.config.section import Count, Section
from sixthsense.core.geometry import Array

_MOST_BLOCKS = 400
_DOOR_M, _HALL_DOOR_M = (0.9, 1.2), 2.0
_BAND_M = (5.0, 7.0)  # depth of the rooms along two sides of a block
_ROOM_M = (4.5, 6.5)  # their width, about
_PILLAR_M, _PILLARS_APART_M = 0.6, 6.0
_PIECE_M, _PIECE_CLEAR_M = (0.5, 1.6), 1.0  # furniture, and its distance from walls: no door is blocked


class Campus(Section):
    """The numbers that a campus is drawn from: the table `campus` of a scene."""

    blocks: tuple[Annotated[int, Field(ge=1, le=_MOST_BLOCKS)], Annotated[int, Field(ge=1, le=_MOST_BLOCKS)]]
    """along x and y"""
    block_m: Annotated[float, Field(ge=20.0, le=1e6)]
    """side of a block"""
    corridor_m: Annotated[float, Field(ge=1.5, le=1e6)]
    """width of the corridors around the blocks"""
    halls: Annotated[float, Field(ge=0.0, le=1.0)]
    """share of the blocks that are a hall with pillars"""
    furniture: Annotated[float, Field(ge=0.0, le=3.0)]
    """mean number of pieces in a room"""
    seed: Count

    @model_validator(mode="after")
    def _few(self) -> Self:
        if self.blocks[0] * self.blocks[1] > _MOST_BLOCKS:
            found = f"{self.blocks[0]} x {self.blocks[1]}"
            raise InputError("blocks", f"found {found}", f"at most {_MOST_BLOCKS} in all")
        return self


def campus_walls(campus: Campus) -> Array:
    """The walls (N, 2, 2), from (0, 0) on; one seed is one campus."""
    rng = np.random.default_rng(campus.seed)
    pitch = campus.block_m + campus.corridor_m
    walls = [_box(np.zeros(2), np.array(campus.blocks) * pitch + campus.corridor_m)]
    for i, j in itertools.product(*map(range, campus.blocks)):
        low = campus.corridor_m + pitch * np.array([i, j], dtype=np.float64)
        walls.append(low + (_hall(campus, rng) if rng.random() < campus.halls else _rooms(campus, rng)))
    return np.concatenate(walls)


def _rooms(campus: Campus, rng: np.random.Generator) -> Array:
    """A block of rooms: a row along its lower and its upper side, and between them two on either hand."""
    side = campus.block_m
    bottom, top = rng.uniform(*_BAND_M, 2)
    middle, across = rng.uniform(0.45, 0.55, 2)
    walls: list[Array] = []
    for depth, outer, inner in ((bottom, 0.0, bottom), (top, side, side - top)):
        count = round(side / rng.uniform(*_ROOM_M))
        edges = np.concatenate([[0.0], np.arange(1, count) + rng.uniform(-0.1, 0.1, count - 1), [count]]) * side / count
        walls.append(_walls([(0.0, inner), (side, inner)]))
        for left, right in itertools.pairwise(edges):
            walls.append(_with_door((left, outer), (right, outer), _DOOR_M, rng))
            walls += _furniture((left, min(outer, inner)), (right - left, depth), campus.furniture, rng)
        walls.append(_walls(*([(x, outer), (x, inner)] for x in edges)))
    height, x = side - top - bottom, middle * side
    y = bottom + across * height
    walls.append(_walls([(x, bottom), (x, side - top)], [(0.0, y), (side, y)]))
    for below, above in ((bottom, y), (y, side - top)):
        walls += [_with_door((at, below), (at, above), _DOOR_M, rng) for at in (0.0, side)]
        walls += _furniture((0.0, below), (x, above - below), campus.furniture, rng)
        walls += _furniture((x, below), (side - x, above - below), campus.furniture, rng)
    return np.concatenate(walls)


def _hall(campus: Campus, rng: np.random.Generator) -> Array:
    """A hall with a wide door in each side and rows of pillars."""
    side = campus.block_m
    walls = [_with_door(a, b, (_HALL_DOOR_M, _HALL_DOOR_M), rng) for a, b in _box(np.zeros(2), np.array([side, side]))]
    count = int(side / _PILLARS_APART_M) - 1
    first = 0.5 * (side - (count - 1) * _PILLARS_APART_M - _PILLAR_M)
    for place in itertools.product(range(count), repeat=2):
        walls.append(_box(first + _PILLARS_APART_M * np.array(place), np.array([_PILLAR_M, _PILLAR_M])))
    return np.concatenate(walls)


def _with_door(a: ArrayLike, b: ArrayLike, width_m: tuple[float, float], rng: np.random.Generator) -> Array:
    """A wall (2, 2, 2) from a to b with a door, away from its ends."""
    begin = np.asarray(a, dtype=np.float64)
    there = np.asarray(b, dtype=np.float64) - begin
    length, width = float(np.hypot(*there)), float(rng.uniform(*width_m))
    at = float(rng.uniform(0.5, length - 0.5 - width))
    shares = np.array([0.0, at / length, (at + width) / length, 1.0])
    return (begin + shares[:, None] * there).reshape(2, 2, 2)


def _furniture(low: ArrayLike, size: ArrayLike, mean: float, rng: np.random.Generator) -> list[Array]:
    """Pieces of furniture in a room, away from its walls and from each other; those without a place are left out."""
    kept: list[tuple[Array, Array]] = []
    for _ in range(rng.poisson(mean)):
        piece = rng.uniform(*_PIECE_M, 2)
        room = np.asarray(size) - piece - 2.0 * _PIECE_CLEAR_M
        at = np.asarray(low) + _PIECE_CLEAR_M + rng.random(2) * np.maximum(room, 0.0)
        gaps = [np.maximum(at - (p + s), p - (at + piece)).max() for p, s in kept]
        if (room > 0.0).all() and min(gaps, default=np.inf) > _PIECE_CLEAR_M:
            kept.append((at, piece))
    return [_box(at, piece) for at, piece in kept]


def _box(low: Array, size: Array) -> Array:
    """The sides (4, 2, 2) of a rectangle, counter-clockwise."""
    corners = low + np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * size
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _walls(*walls: Sequence[tuple[float, float]]) -> Array:
    return np.array(walls, dtype=np.float64)
