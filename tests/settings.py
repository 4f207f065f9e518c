"""For each field of the configuration another valid value than the default."""

import dataclasses
import types
import typing
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from sixthsense.config import Config, Range, Section
from sixthsense.config.parts import PartOptions, Parts

STATED = {
    "scene": "rectangle", "preset": "worn", "goal": (1.25, -0.75), "start": (-1.25, -0.4, 0.3),
    "tour": ((1.5, -0.5), (-1.5, 0.25)), "region": (-1.75, -1.5, 1.9, 1.6), "max_time": 0.3, "estimator": "isam2",
    "people": True, "no_odometry": True, "front_end": "scan-matching",
}  # fmt: skip
"""values that follow from no type"""
TOGETHER = {
    "goal": None, "task": "tour", "no_odometry": False, "front_end": "landmarks", "estimator": "ekf-oc",
    "laser.mirrored": False,
}  # fmt: skip
"""values, besides, with which all others are valid at once"""


def other(hint: Any, value: Any, step: float) -> Any:
    """A valid value of the annotated type, another one than `value`; it differs for each `step` if it is a number."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        for note in args[1:]:
            if isinstance(note, Parts):
                return next((name for name in note if name != value), note.shipped[value])
            if isinstance(note, Range):
                return next(found for found in candidates(args[0], value, step) if found in note)
        return other(args[0], value, step)
    if origin is Literal:
        return next(choice for choice in args if choice != value)
    if origin in (typing.Union, types.UnionType):
        return other(args[0], value, step)
    if origin is tuple:
        return tuple(other(args[0], one, step + 0.1 * k) for k, one in enumerate(value))
    return not value if hint is bool else next(candidates(hint, value, step))


def candidates(hint: type, value: float, step: float) -> Iterator[float]:
    if hint is int:
        yield from (value + 1, value - 1)
    else:
        yield from (value * (1.0 + step) if value else step, value * (1.0 - step))


def fields(section: type[Section] = Config, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Dotted name, annotated type and default of every field."""
    hints = typing.get_type_hints(section, include_extras=True)
    for field in dataclasses.fields(section):  # type: ignore[arg-type]
        hint = hints[field.name]
        if isinstance(hint, type) and issubclass(hint, Section):
            yield from fields(hint, f"{path}{field.name}.")
        elif hint is not PartOptions:
            yield path + field.name, hint, getattr(section(), field.name)


def changed() -> dict[str, Any]:
    """The other value of each field, by dotted name."""
    found = {}
    for k, (name, hint, default) in enumerate(fields()):
        found[name] = STATED[name] if name in STATED else other(hint, default, 0.01 + 1e-4 * k)
    return found


def nested(flat: dict[str, Any]) -> dict[str, Any]:
    """The table of a file, from dotted names."""
    table: dict[str, Any] = {}
    for name, value in flat.items():
        *sections, field = name.split(".")
        target = table
        for section in sections:
            target = target.setdefault(section, {})
        target[field] = value
    return table


def flat(section: Section, path: str = "") -> dict[str, Any]:
    """The value of each field, by dotted name."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(section):  # type: ignore[arg-type]
        value = getattr(section, field.name)
        if isinstance(value, PartOptions):
            continue
        found |= flat(value, f"{path}{field.name}.") if isinstance(value, Section) else {path + field.name: value}
    return found


def words(flags: dict[str, Any]) -> list[str]:
    """The options of a command line that set these fields."""
    said: list[str] = []
    for name, value in flags.items():
        flag = f"--{name.replace('_', '-')}"
        rows = value if isinstance(value, tuple) else (value,)
        numbers = [number for row in rows for number in (row if isinstance(row, tuple) else (row,))]
        said += [flag, *(str(one).lower() if isinstance(one, bool) else str(one) for one in numbers)]
    return said
