"""Fields and presets of earlier versions: a file with such a field at its default is read, other values are errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sixthsense.config.section import ConfigError, shown


@dataclass(frozen=True)
class Removed:
    """A field that is no longer there."""

    default: Any
    """with which it had no effect"""
    reason: str
    """why it was removed, a sentence that follows "was removed: " """


_PROBATION = "landmarks join the state at their first sighting, since waiting multiplied the trajectory's error by 5.8"

REMOVED: dict[str, Removed] = {
    "association.candidate_sightings": Removed(1, _PROBATION),
    "association.candidate_gate_m": Removed(0.2, _PROBATION),
    "association.candidate_scans": Removed(30, _PROBATION),
}

REMOVED_PRESETS = {
    "intel": "it had the wheels of one robot, and a log says itself what its laser is",
}
"""by name: why it was removed"""


def without_removed(table: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """A file's nested table without removed fields; ConfigError for one that is not at its default."""
    kept: dict[str, Any] = {}
    for key, value in table.items():
        name = f"{path}{key}"
        removed = REMOVED.get(name.replace("-", "_"))
        if removed is None:
            kept[key] = without_removed(value, f"{name}.") if isinstance(value, Mapping) else value
        elif isinstance(value, bool) or value != removed.default:
            raise ConfigError(f"{name}: found {shown(value)}; was removed: {removed.reason}; allowed: leave it out")
    return kept
