"""Units of a log: metres and radians, or what the user says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sixthsense.config.errors import InputError

DEGREES = math.pi / 180.0
_LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_ANGLES = {"radians": 1.0, "degrees": DEGREES}
_NAMES = {"ranges": _LENGTHS, "odometry": _LENGTHS, "angles": _ANGLES, "headings": _ANGLES}


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
