"""Files of scenes: where they are, and what a `.toml` file may state. Metres and radians, world frame.

Loads nothing large, so that a wrong name is told at once.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.files import parse_toml, path_of
from sixthsense.config.section import Section, input_error, shown

M = TypeVar("M", bound=BaseModel)

SUFFIXES = (".toml", ".yaml", ".yml")
MAX_WALLS = 50_000
"""every beam is compared with every wall"""
_OTHER_LISTS = 2_000  # at most, of a scene's tour, polygons, glass and comments
_LIMIT_M = 1e6
_LONGEST = 1 << 23  # characters; an endless stream must not fill the memory
_SHORTEST_WALL_M = 1e-6
_MOST_WALKS = 200

Coordinate = Annotated[float, Field(strict=True, ge=-_LIMIT_M, le=_LIMIT_M)]
Point = tuple[Coordinate, Coordinate]
Region = tuple[float, float, float, float]
Wall = tuple[Coordinate, Coordinate, Coordinate, Coordinate]


def _with_length(wall: Wall) -> Wall:
    if math.dist(wall[:2], wall[2:]) < _SHORTEST_WALL_M:
        raise InputError("", f"found a wall of no length at ({wall[0]:g}, {wall[1]:g})", "two different ends")
    return wall


def ordered(region: Region) -> Region:
    """A region with its corners in order; InputError otherwise."""
    x0, y0, x1, y1 = region
    if not (x0 < x1 and y0 < y1):
        raise InputError("region", f"found [{x0:g}, {y0:g}, {x1:g}, {y1:g}]", "x0 < x1 and y0 < y1")
    return region


def in_radians(start: tuple[float, float, float]) -> tuple[float, float, float]:
    """A start, x y theta, whose heading is no number of degrees; InputError otherwise."""
    if abs(start[2]) > 2.0 * math.pi:
        raise InputError("", f"found the heading {start[2]:g}", "radians, -6.28 to 6.28")
    return start


class ScriptedWalk(Section):
    """A walk that a scene states: way points that someone visits again and again, each by the shortest way."""

    points: tuple[Point, ...]
    speed: Annotated[float, Field(gt=0.0, le=3.0)] = 1.0
    """m/s"""
    pauses: tuple[Annotated[float, Field(ge=0.0, le=1e6)], ...] | None = None
    """at each way point, s; None: none"""

    @model_validator(mode="after")
    def _paused(self) -> Self:
        if self.pauses is not None and len(self.pauses) != len(self.points):
            allowed = f"a time for each of the {len(self.points)} way points"
            raise InputError("pauses", f"found {len(self.pauses)}", allowed)
        return self

    def pause_s(self, k: int) -> float:
        """The pause at way point k."""
        return 0.0 if self.pauses is None else self.pauses[k]


class Polygon(Section):
    """A closed polygon, or an open polyline."""

    points: tuple[Point, ...]
    closed: bool = True

    @model_validator(mode="after")
    def _with_sides(self) -> Self:
        least = 3 if self.closed else 2
        if len(self.points) < least:
            raise InputError("points", f"found {len(self.points)}", f"at least {least}")
        for wall in self.walls():
            _with_length(wall)
        return self

    def walls(self) -> list[Wall]:
        """Its sides."""
        ends = [*self.points, self.points[0]] if self.closed else self.points
        return [(*a, *b) for a, b in itertools.pairwise(ends)]


class SceneFile(BaseModel):
    """The fields of a scene, as a file states them."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    start: Annotated[tuple[Coordinate, Coordinate, Coordinate], AfterValidator(in_radians)]
    """x, y and heading of the robot"""
    radius: Annotated[float, Field(strict=True, gt=0.0, le=_LIMIT_M)]
    """of the robot"""
    goal: Point | None = None
    tour: tuple[Point, ...] = ()
    region: Wall | None = None
    """x0 y0 x1 y1; None: the bounds of the walls"""
    walls: list[Annotated[Wall, AfterValidator(_with_length)]] = []
    """by their two ends"""
    polygons: tuple[Polygon, ...] = ()
    glass: list[Annotated[Wall, AfterValidator(_with_length)]] = []
    """stops the robot and no beam"""
    walkers: Annotated[tuple[ScriptedWalk, ...], Field(max_length=_MOST_WALKS)] = ()


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


def read_scene(path: Path) -> SceneFile:
    """The fields of a `.toml` file; InputError, without the file's name, which names the field."""
    text = read_text(path)
    check_count("walls", text.count("[") - _OTHER_LISTS)  # before they are parsed, which takes 10 s for 200,000
    try:
        return checked(SceneFile, parse_toml(text))
    except InputError:
        raise
    except ValueError as error:
        raise InputError("", str(error)) from None


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


def checked(kind: type[M], table: Any) -> M:
    """A table as a model of this kind; InputError that names the field and the entry of a list."""
    try:
        return kind.model_validate(table)
    except ValidationError as error:
        first, found = error.errors(include_url=False)[0], input_error(error, kind.model_fields)
    if first["type"] == "missing" and len(first["loc"]) == 1:
        required = [name for name, field in kind.model_fields.items() if field.is_required()]
        raise InputError(found.where, f"missing, required are {', '.join(required)}")
    if first["type"] == "too_long":
        raise InputError(found.where, f"found {first['ctx']['actual_length']}", f"at most {first['ctx']['max_length']}")
    name, _, part = found.where.partition(".")
    entry = next((f"entry {k + 1}" for k in first["loc"] if isinstance(k, int)), "")
    raise found.at(", ".join(filter(None, [name, entry, part])))
