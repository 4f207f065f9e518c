"""Checks of the fields of scene files, with one-line errors that name the field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.config.section import is_one_line, shown, shown_name
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.sources.scene_names import SceneError

Point = tuple[float, float]
Region = tuple[float, float, float, float]

MAX_WALLS = 50_000
"""every beam is compared with every wall"""
_LIMIT_M = 1e6
_LONGEST = 1 << 23  # characters; an endless stream must not fill the memory
_SHORTEST_WALL_M = 1e-6
_POLYGON_KEYS = ("points", "closed")


def read_text(path: Path) -> str:
    """The text of a UTF-8 file; SceneError, without the file's name, if it cannot be read or is not text."""
    try:
        if path.is_fifo():  # reading from it may block forever
            raise SceneError("is a pipe, allowed: a text file")
        with path.open(encoding="utf-8-sig") as stream:
            text = stream.read(_LONGEST + 1)
    except OSError as error:
        raise SceneError(f"cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError as error:
        raise SceneError(f"byte {error.start} is not UTF-8, allowed: a text file") from None
    if len(text) > _LONGEST:
        raise SceneError(f"found over {_LONGEST} characters, allowed: a scene")
    return text


def check_count(where: str, found: int, reason: str = "") -> None:
    """Raise SceneError for more walls than a simulation can do with."""
    if found > MAX_WALLS:
        raise SceneError(f"{where}: found {found:,} walls or more, allowed: at most {MAX_WALLS:,}{reason}")


def read_name(where: str, value: Any) -> str:
    """A printable file name."""
    if not isinstance(value, str) or not value or not is_one_line(value):
        raise SceneError(f"{where}: found {shown(value)}, not a readable image, allowed: the name of a file")
    return value


def check_keys(where: str, table: dict[Any, Any], known: Sequence[str], required: Sequence[str]) -> None:
    """Raise SceneError for the first key of `table` that is unknown, or of `required` that is missing."""
    for key in table:
        if key not in known:
            raise SceneError(f"{where}{shown_name(key)}: no such field, {allowed_names(known, nearest(key, known))}")
    for key in required:
        if key not in table:
            raise SceneError(f"{where}{key}: missing, required are {', '.join(required)}")


def read_floats(words: list[str]) -> list[float | str]:
    """Words as numbers; a word that is not a number is kept for the error message."""
    values: list[float | str] = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            values.append(word)
    return values


def read_list(where: str, value: Any) -> list[Any]:
    """A list."""
    if not isinstance(value, list):
        raise SceneError(f"{where}: found {shown(value)}, allowed: a list")
    return value


def read_numbers(where: str, values: Any, names: str) -> tuple[float, ...]:
    """One finite float for each of the space-separated `names`."""
    count = len(names.split())
    found = list(values) if isinstance(values, (list, tuple, np.ndarray)) else []
    usable = (
        len(found) == count
        and all(isinstance(v, (int, float, np.number)) and not isinstance(v, bool) for v in found)
        and all(abs(v) <= _LIMIT_M for v in found)  # false for NaN
    )
    if not usable:
        raise SceneError(
            f"{where}: found {shown(values)}, allowed: {count} numbers ({names}), none beyond {_LIMIT_M:.0e}"
        )
    return tuple(float(v) for v in found)


def read_positive(where: str, value: Any, unit: str = "metres") -> float:
    """A finite number above 0, by default a length."""
    usable = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not usable or not 0.0 < value <= _LIMIT_M:
        raise SceneError(f"{where}: found {shown(value)}, allowed: a number above 0, {unit}")
    return float(value)


def read_point(where: str, values: Any) -> Point:
    """Two finite numbers, x and y."""
    x, y = read_numbers(where, values, "x y")
    return x, y


def read_region(where: str, values: Any) -> Region:
    """Four finite numbers, x0 y0 x1 y1, corners in order."""
    x0, y0, x1, y1 = read_numbers(where, values, "x0 y0 x1 y1")
    if not (x0 < x1 and y0 < y1):
        raise SceneError(f"{where}: found [{x0:g}, {y0:g}, {x1:g}, {y1:g}], allowed: x0 < x1 and y0 < y1")
    return x0, y0, x1, y1


def read_wall(where: str, values: Any) -> list[Point]:
    """The two ends of a wall of positive length."""
    x1, y1, x2, y2 = read_numbers(where, values, "x1 y1 x2 y2")
    if math.hypot(x2 - x1, y2 - y1) < _SHORTEST_WALL_M:
        raise SceneError(f"{where}: found a wall of no length at ({x1:g}, {y1:g}), allowed: two different ends")
    return [(x1, y1), (x2, y2)]


def read_polygon(where: str, table: Any) -> list[list[Point]]:
    """The sides of a closed polygon or of an open polyline."""
    if not isinstance(table, dict):
        raise SceneError(f"{where}: found {shown(table)}, allowed: a table with {', '.join(_POLYGON_KEYS)}")
    check_keys(f"{where}, ", table, _POLYGON_KEYS, ("points",))
    closed = table.get("closed", True)
    if not isinstance(closed, bool):
        raise SceneError(f"{where}, closed: found {shown(closed)}, allowed: true or false")
    points = [
        read_point(f"{where}, point {k}", p) for k, p in enumerate(read_list(f"{where}, points", table["points"]), 1)
    ]
    least = 3 if closed else 2
    if len(points) < least:
        raise SceneError(f"{where}, points: found {len(points)}, allowed: at least {least}")
    ends = [*points[1:], points[0]] if closed else points[1:]
    return [read_wall(f"{where}, side {k}", [*a, *b]) for k, (a, b) in enumerate(zip(points, ends, strict=False), 1)]
