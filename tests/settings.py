"""For each field of the configuration another valid value than the default."""

import math
from collections.abc import Iterator
from typing import Any

from pydantic.fields import FieldInfo

from sixthsense.config import Config, Section
from sixthsense.config.parts import Parts
from sixthsense.config.section import choices_of, kind_of

STATED = {
    "scene": "rectangle", "preset": "worn", "goal": (1.25, -0.75), "start": (-1.25, -0.4, 0.3),
    "tour": ((1.5, -0.5), (-1.5, 0.25)), "region": (-1.75, -1.5, 1.9, 1.6), "max_time": 0.3, "estimator": "isam2",
    "people": True, "no_odometry": True, "front_end": "scan-matching",
    "time_offset": 0.05,
}  # fmt: skip
"""values that follow from no type"""
TOGETHER = {
    "goal": None, "task": "tour", "no_odometry": False, "front_end": "landmarks", "estimator": "ekf",
    "laser.mirrored": False,
}  # fmt: skip
"""values, besides, with which all others are valid at once"""


def other(field: FieldInfo, value: Any, step: float) -> Any:
    """A valid value of a field, another one than `value`; it differs for each `step` if it is a number."""
    kind, notes = kind_of(field)
    for note in notes:
        if isinstance(note, Parts):
            return next((name for name in note if name != value), note.shipped[value])
    if names := choices_of(field):
        return next(name for name in names if name != value)
    if isinstance(value, tuple):
        return tuple(one + step + 0.1 * k for k, one in enumerate(value))
    if kind is bool:
        return not value
    steps = (value + 1, value - 1) if kind is int else (value * (1.0 + step) if value else step, value * (1.0 - step))
    high = min((note.le for note in notes if hasattr(note, "le")), default=math.inf)
    return next(found for found in steps if found <= high)


def fields(section: type[Section] = Config, path: str = "") -> Iterator[tuple[str, FieldInfo, Any]]:
    """Dotted name, field and default of every field."""
    for name, field in section.model_fields.items():
        value = field.get_default(call_default_factory=True)
        if isinstance(value, Section):
            yield from fields(type(value), f"{path}{name}.")
        elif not isinstance(value, dict):
            yield path + name, field, value


def changed() -> dict[str, Any]:
    """The other value of each field, by dotted name."""
    found = {}
    for k, (name, field, default) in enumerate(fields()):
        found[name] = STATED[name] if name in STATED else other(field, default, 0.01 + 1e-4 * k)
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
    for name, value in section:
        if not isinstance(value, dict):
            found |= flat(value, f"{path}{name}.") if isinstance(value, Section) else {path + name: value}
    return found


def words(flags: dict[str, Any]) -> list[str]:
    """The options of a command line that set these fields."""
    said: list[str] = []
    for name, value in flags.items():
        flag = f"--{name.replace('_', '-')}"
        if name == "scene":
            said.insert(0, value)
            continue
        if isinstance(value, bool):
            said.append(f"{flag}={str(value).lower()}")
            continue
        rows = value if isinstance(value, tuple) else (value,)
        numbers = [number for row in rows for number in (row if isinstance(row, tuple) else (row,))]
        said += [flag, *map(str, numbers)]
    return said
