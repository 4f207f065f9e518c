"""Files of scenes: their names, and checks of their fields with one-line errors that name the field.

Loads nothing large, so that a wrong name is told at once.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.files import path_of
from sixthsense.config.section import Section, shown, shown_name

T = TypeVar("T")
S = TypeVar("S", bound=Section)
Point = tuple[float, float]
Region = tuple[float, float, float, float]

SUFFIXES = (".toml", ".yaml", ".yml", ".scn")
MAX_WALLS = 50_000
"""every beam is compared with every wall"""
_LIMIT_M = 1e6
_LONGEST = 1 << 23  # characters; an endless stream must not fill the memory
_SHORTEST_WALL_M = 1e-6

Coordinate = Annotated[float, Field(ge=-_LIMIT_M, le=_LIMIT_M)]


def shipped_scenes() -> dict[str, Path]:
    """The files of the shipped scenes by name, in alphabetical order."""
    package = Path(__file__).resolve().parents[1]
    # A wheel contains the scenes inside the package; an editable install has them in the root of the repository.
    folder = next((f for f in (package / "scenes", package.parent / "scenes") if f.is_dir()), None)
    return {} if folder is None else {file.stem: file for file in sorted(folder.glob("*.toml"))}


def scene_file(name_or_file: str | Path) -> Path:
    """The file of a shipped scene, or the file itself; InputError for a name that is neither, with the known ones."""
    shipped = shipped_scenes()
    path = shipped.get(str(name_or_file), path_of("scene", name_or_file))
    if path.suffix.lower() not in SUFFIXES:
        found = str(name_or_file)
        allowed = f"{', '.join(shipped)}, or a file ending in {', '.join(SUFFIXES)}"
        raise InputError("scene", f"found {shown(found)}", allowed, nearest(found, shipped))
    return path


def read_text(path: Path) -> str:
    """The text of a UTF-8 file; InputError, without the file's name, if it cannot be read or is not text."""
    try:
        if path.is_fifo():  # reading from it may block forever
            raise InputError("", "is a pipe", "a text file")
        with path.open(encoding="utf-8-sig") as stream:
            text = stream.read(_LONGEST + 1)
    except OSError as error:
        raise InputError("", f"cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError as error:
        raise InputError("", f"byte {error.start} is not UTF-8", "a text file") from None
    if len(text) > _LONGEST:
        raise InputError("", f"found over {_LONGEST} characters", "a scene")
    return text


def check_count(where: str, found: int, reason: str = "") -> None:
    """Raise InputError for more walls than a simulation can do with."""
    if found > MAX_WALLS:
        raise InputError(where, f"found {found:,} walls or more", f"at most {MAX_WALLS:,}{reason}")


def check_keys(where: str, table: dict[Any, Any], known: Sequence[str], required: Sequence[str]) -> None:
    """Raise InputError for the first key of `table` that is unknown, or of `required` that is missing."""
    for key in table:
        if key not in known:
            raise InputError(f"{where}{shown_name(key)}", "no such field", ", ".join(known), nearest(key, known))
    for key in required:
        if key not in table:
            raise InputError(f"{where}{key}", f"missing, required are {', '.join(required)}")


def read_section(where: str, table: Any, kind: type[S]) -> S:
    """A table as a section of this kind, whose fields without a default are required."""
    known = {name: field.is_required() for name, field in kind.model_fields.items()}
    if not isinstance(table, dict):
        raise InputError(where, f"found {shown(table)}", f"a table with {', '.join(known)}")
    prefix = f"{where}, " if where else ""
    check_keys(prefix, table, list(known), [name for name, is_required in known.items() if is_required])
    try:
        return kind(**table)
    except InputError as error:
        raise error.at(f"{prefix}{error.where}") from None


def read_floats(words: Iterable[Any]) -> list[Any]:
    """Words as numbers; a word that is not a number is kept for the error message."""
    values: list[Any] = []
    for word in words:
        try:
            values.append(float(word))
        except (TypeError, ValueError):
            values.append(word)
    return values


def read_each(where: str, values: Any, read: Callable[[str, Any], T]) -> list[T]:
    """The entries of a list, each by `read`, which takes the entry's name for messages and its value."""
    if not isinstance(values, list):
        raise InputError(where, f"found {shown(values)}", "a list")
    return [read(f"{where}, entry {k}", value) for k, value in enumerate(values, 1)]


def read_numbers(where: str, values: Any, names: str) -> tuple[float, ...]:
    """One finite float for each of the space-separated `names`."""
    count = len(names.split())
    is_list = isinstance(values, Iterable) and not isinstance(values, (str, bytes, Mapping))
    found: list[Any] = list(values) if is_list else []
    is_number = all(isinstance(v, numbers.Real) and not isinstance(v, bool) for v in found)
    if len(found) != count or not is_number or not all(abs(v) <= _LIMIT_M for v in found):  # true for NaN
        raise InputError(where, f"found {shown(values)}", f"{count} numbers ({names}), none beyond {_LIMIT_M:.0e}")
    return tuple(float(v) for v in found)


def read_positive(where: str, value: Any) -> float:
    """A length above 0."""
    usable = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not usable or not 0.0 < value <= _LIMIT_M:
        raise InputError(where, f"found {shown(value)}", "a number above 0, metres")
    return float(value)


def read_point(where: str, values: Any) -> Point:
    """Two finite numbers, x and y."""
    x, y = read_numbers(where, values, "x y")
    return x, y


def read_region(where: str, values: Any) -> Region:
    """Four finite numbers, x0 y0 x1 y1, corners in order."""
    x0, y0, x1, y1 = read_numbers(where, values, "x0 y0 x1 y1")
    if not (x0 < x1 and y0 < y1):
        raise InputError(where, f"found [{x0:g}, {y0:g}, {x1:g}, {y1:g}]", "x0 < x1 and y0 < y1")
    return x0, y0, x1, y1


def read_wall(where: str, values: Any) -> list[Point]:
    """The two ends of a wall of positive length."""
    x1, y1, x2, y2 = read_numbers(where, values, "x1 y1 x2 y2")
    if math.hypot(x2 - x1, y2 - y1) < _SHORTEST_WALL_M:
        raise InputError(where, f"found a wall of no length at ({x1:g}, {y1:g})", "two different ends")
    return [(x1, y1), (x2, y2)]


class _Polygon(Section):
    """A closed polygon, or an open polyline."""

    points: tuple[tuple[Coordinate, Coordinate], ...]
    closed: bool = True


def read_polygon(where: str, table: Any) -> list[list[Point]]:
    """The sides of a closed polygon or of an open polyline."""
    found = read_section(where, table, _Polygon)
    points, least = found.points, 3 if found.closed else 2
    if len(points) < least:
        raise InputError(f"{where}, points", f"found {len(points)}", f"at least {least}")
    ends = [*points[1:], points[0]] if found.closed else points[1:]
    return [read_wall(f"{where}, side {k}", [*a, *b]) for k, (a, b) in enumerate(zip(points, ends, strict=False), 1)]
