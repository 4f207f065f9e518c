"""Files of scenes: where they are, and what a `.toml` file may state. Metres and radians, world frame.

Loads nothing large, so that a wrong name is told at once.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.files import path_of
from sixthsense.config.section import Section, input_error, shown, shown_name

M = TypeVar("M", bound=BaseModel)

SUFFIXES = (".toml", ".yaml", ".yml")

Coordinate = Annotated[float, Field(strict=True, ge=-1e6, le=1e6)]
Point = tuple[Coordinate, Coordinate]
Region = tuple[float, float, float, float]
Wall = tuple[Coordinate, Coordinate, Coordinate, Coordinate]


def ordered(region: Region) -> Region:
    """A region with its corners in order; InputError otherwise."""
    x0, y0, x1, y1 = region
    if not (x0 < x1 and y0 < y1):
        raise InputError("region", f"found [{x0:g}, {y0:g}, {x1:g}, {y1:g}]", "x0 < x1 and y0 < y1")
    return region


def in_radians(start: tuple[float, float, float]) -> tuple[float, float, float]:
    """A start, x y theta, whose heading is no number of degrees; InputError otherwise."""
    if abs(start[2]) > 2.0 * math.pi:
        raise InputError("start", f"found the heading {start[2]:g}", "radians, -6.28 to 6.28")
    return start


class ScriptedWalk(Section):
    """A walk that a scene states: way points that someone visits again and again, each by the shortest way."""

    points: Annotated[tuple[Point, ...], Field(min_length=1)]
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


class SceneFile(BaseModel):
    """The fields of a scene, as a file states them."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    start: tuple[Coordinate, Coordinate, Coordinate]
    """x, y and heading of the robot"""
    radius: Annotated[float, Field(strict=True, gt=0.0, le=1e6)]
    """of the robot"""
    goal: Point | None = None
    tour: tuple[Point, ...] = ()
    region: Wall | None = None
    """x0 y0 x1 y1; None: the bounds of the walls"""
    walls: tuple[Wall, ...] = ()
    """by their two ends"""
    polygons: tuple[Polygon, ...] = ()
    glass: tuple[Wall, ...] = ()
    """stops the robot and no beam"""
    walkers: Annotated[tuple[ScriptedWalk, ...], Field(max_length=200)] = ()

    def segments(self) -> list[Wall]:
        """The walls, with the sides of the polygons."""
        found = [*self.walls]
        for polygon in self.polygons:
            ends = polygon.points + polygon.points[:1] * polygon.closed
            found += [(*a, *b) for a, b in itertools.pairwise(ends)]
        return found


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


def checked(kind: type[M], table: Any) -> M:
    """A table as a model of this kind; InputError that names the field and the entry of a list."""
    try:
        return kind.model_validate(table)
    except ValidationError as error:
        first, found = error.errors(include_url=False)[0], input_error(error, kind.model_fields)
    names = [f"entry {part + 1}" if isinstance(part, int) else shown_name(part) for part in first["loc"]]
    cause = first.get("ctx", {}).get("error")
    where = ", ".join(filter(None, [*names, cause.where if isinstance(cause, InputError) else ""]))
    if first["type"] in ("missing", "too_short", "too_long") or (len(names) > 1 and "_than_" in first["type"]):
        raise InputError(where, first["msg"])
    raise found.at(where)
