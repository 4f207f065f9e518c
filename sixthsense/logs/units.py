"""Units of a log: metres and radians, or what the user says; and what can only be another unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.core.laser import MOST_RANGE_M
from sixthsense.logs.laser_geometry import no_return_code

_LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_ANGLES = {"radians": 1.0, "degrees": math.pi / 180.0}
_NAMES = {"ranges": _LENGTHS, "odometry": _LENGTHS, "angles": _ANGLES, "headings": _ANGLES}

_MOST_TURN = 3.0 * math.pi
"""Beams span at most a full turn; some drivers send a few more."""
_FASTEST = 20.0
"""m/s of a vehicle; a slow robot in centimetres is faster"""
_ASIDE, _AHEAD = 0.5, 0.25
"""Of the way that a robot on wheels goes: the share across a heading that is not its own, and across its own."""
_COMPARED = 100  # scans, evenly over the log
_FEWEST, _USUAL = 10, 0.9  # motions, and the share of them that are no jumps


@dataclass(frozen=True, slots=True)
class Units:
    """What a number of the log is, in metres and radians."""

    ranges: float = 1.0
    """metres in one unit of a range"""
    odometry: float = 1.0
    """metres in one unit of a position"""
    angles: float = 1.0
    """radians in one unit of the bearings of a laser"""
    headings: float = 1.0
    """radians in one unit of the headings of a CARMEN log"""


SI = Units()


def units_of(words: Sequence[str]) -> Units:
    """The units that an option says, such as `ranges=mm`; InputError for another word."""
    found = {}
    for word in words:
        name, _, unit = word.strip().partition("=")
        if unit not in _NAMES.get(name, {}):
            allowed = ", ".join(f"{name}={'|'.join(units)}" for name, units in _NAMES.items())
            raise InputError("units", f"found {word!r}", allowed)
        found[name] = _NAMES[name][unit]
    return Units(**found)


def check_bearings(first: float, last: float) -> None:
    """Raise ValueError for bearings of the first and the last beam, rad, that can only be degrees."""
    if abs(last - first) > _MOST_TURN and abs(last - first) <= 360.0 * 1.01:
        raise ValueError(
            f"found angles of {first:.6g} to {last:.6g}, which are degrees, allowed: radians, or `units` angles=degrees"
        )


def check_ranges(where: str, ranges: Sequence[NDArray[np.float32]]) -> None:
    """Raise InputError for scans, of (beams,) ranges each, that can only be millimetres or centimetres."""
    some = ranges[:: max(1, len(ranges) // _COMPARED)]
    code = no_return_code(some) or math.inf
    returns = np.concatenate([row[(row > 0.0) & np.isfinite(row) & (row < code)] for row in some])
    if len(returns) and (median := float(np.median(returns))) > MOST_RANGE_M:
        raise InputError(
            where,
            f"found ranges with a median of {median:.5g}, which are millimetres or centimetres",
            "metres, or `units` ranges=mm or ranges=cm",
        )


def check_odometry(where: str, passed_s: Array, poses: Array) -> None:
    """Raise InputError for poses (N, 3), with (N - 1,) times between them, that can only be in another unit."""
    steps = np.diff(poses, axis=0)
    moved = np.hypot(steps[:, 0], steps[:, 1])
    moves = (moved > 0.0) & np.isfinite(passed_s)
    if not moves.any():
        return
    is_usual = moves & (moved <= np.quantile(moved[moves], _USUAL))
    if np.count_nonzero(is_usual) < _FEWEST:
        return
    speed = float(moved[is_usual].sum() / max(passed_s[moves].sum(), 1e-9))
    if speed > _FASTEST:
        raise InputError(
            where,
            f"found positions of odometry that change by {speed:.4g} a second, which are millimetres or centimetres",
            "metres, or `units` odometry=mm or odometry=cm",
        )
    course, headings = np.arctan2(steps[is_usual, 1], steps[is_usual, 0]), poses[:-1][is_usual, 2]
    across, by_degrees = (
        float(moved[is_usual] @ np.abs(np.sin(course - unit * headings)) / moved[is_usual].sum())
        for unit in (1.0, _ANGLES["degrees"])
    )
    if across > _ASIDE and by_degrees < _AHEAD:
        most = float(np.abs(poses[:, 2]).max())
        raise InputError(
            where,
            f"found headings of odometry up to {most:.4g}, along which the robot goes if they are degrees",
            "radians, or `units` headings=degrees",
        )
