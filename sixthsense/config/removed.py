"""Fields, values and names of earlier versions: renamed ones are read with a note, removed ones at their defaults."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sixthsense.config.section import ConfigError, shown


class RenamedWarning(FutureWarning):
    """A note that names the new name of what an earlier version called otherwise."""


@dataclass(frozen=True)
class Removed:
    """A field that is no longer there."""

    default: Any
    """with which it had no effect"""
    reason: str
    """why it was removed, a sentence that follows "was removed: " """


_PROBATION = (
    "landmarks join the state at their first observation, since waiting multiplied the trajectory's error by 5.8"
)

_ONE_ASSIGNMENT = "the matches of a keyframe are chosen together, in one way"
_TOUR = "the next view is the first of a short tour through all views, not the one with the most gain per time"

REMOVED: dict[str, Removed] = {
    "association.candidate_sightings": Removed(1, _PROBATION),
    "association.candidate_gate_m": Removed(0.2, _PROBATION),
    "association.candidate_scans": Removed(30, _PROBATION),
    "association.joint_probability": Removed(0.999, _ONE_ASSIGNMENT),
    "association.align": Removed(
        {
            "enabled": True,
            "steps": 6,
            "headings_rad": [0.12, 0.25],
            "reach_m": 0.6,
            "reach_rad": 0.2,
            "scale_m": 0.05,
            "enough": 0.6,
            "margin": 0.15,
        },
        "the matches of a keyframe are chosen together, which needs no aligned pose",
    ),
    "explore.gain_exponent": Removed(0.15, _TOUR),
    "explore.overhead_s": Removed(1.0, _TOUR),
}

REMOVED_PRESETS = {
    "intel": "it had the wheels of one robot, and a log says itself what its laser is",
}
"""by name: why it was removed"""

RENAMED: dict[str, str] = {
    "keyscans": "keyframes",
    "scans.revisits": "scans.loop_closures",
    "explore.revisit": "explore.loop_closure",
    "explore.revisit_sigma_m": "explore.loop_closure_sigma_m",
}
"""by dotted name: the new name of a field or section, in the same section"""

_OLD_GATES = (
    "method", "match_probability", "new_probability", "match_below", "new_above", "assignment", "culling",
)  # fmt: skip

RENAMED_VALUES: dict[str, dict[str, str]] = {
    "front_end": {"scans": "scan-matching"},
    "association.proposed_by": {"scans": "scan-matching"},
}
"""by dotted name of a field: the new names of its values"""


def note_renamed(old: str, new: str) -> None:
    """Warn that `old` is now called `new`."""
    warnings.warn(f"{old} is now called {new}", RenamedWarning, stacklevel=3)


class OldName:
    """An attribute's name of an earlier version: reads the attribute that has the new name, with a note."""

    def __init__(self, old: str, new: str) -> None:
        self._old, self._new = old, new

    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            return self
        note_renamed(f"{owner.__name__}.{self._old}", self._new)
        return getattr(instance, self._new)


def current_name(dotted: str) -> str:
    """The present name of a field, section or option, given by its name of any version (a_b.c_d)."""
    for old, new in RENAMED.items():
        if dotted == old or dotted.startswith(f"{old}."):
            return new + dotted[len(old) :]
    return dotted


def with_current_names(table: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """A nested table with renamed fields and values under their new names, and a note for each.

    Raises ConfigError for a field that is given under both names.
    """
    current: dict[str, Any] = {}
    for key, value in table.items():
        dotted = f"{path}{key}".replace("-", "_")
        name = current_name(dotted)
        if name != dotted:
            note_renamed(f"{path}{key}", name)
            key = name.rpartition(".")[2]
        values = RENAMED_VALUES.get(name, {})
        if isinstance(value, str) and value in values:
            note_renamed(f"{name} {value}", values[value])
            value = values[value]
        if key in current:
            raise ConfigError(f"{path}{key}: found under its old name, too, allowed: one of the two")
        current[key] = with_current_names(value, f"{name}.") if isinstance(value, Mapping) else value
        if name == "association" and isinstance(value, Mapping):
            current[key] = _with_current_gates(current[key])
    return current


def _with_current_gates(association: dict[str, Any]) -> dict[str, Any]:
    """The section's fields of earlier versions as gates on the squared distance, and no culling as `cull_below`."""
    old = {name: association.pop(name) for name in _OLD_GATES if name in association}
    if not old:
        return association
    note_renamed(", ".join(f"association.{name}" for name in old), "association.match_gate, new_gate and cull_below")
    current: dict[str, Any] = {}
    method = old.get("method", "chi2")
    if method == "report":
        current = {"match_gate": old.get("match_below", 20.0), "new_gate": old.get("new_above", 200.0)}
    elif method == "chi2":
        for gate, name in (("match_gate", "match_probability"), ("new_gate", "new_probability")):
            if name in old:
                current[gate] = _gate(f"association.{name}", old[name])
    else:
        raise ConfigError(f"association.method: found {shown(method)}, allowed: leave it out")
    if old.get("culling") is False:
        current["cull_below"] = 0
    for name in current.keys() & association.keys():
        raise ConfigError(f"association.{name}: found under its old name, too, allowed: one of the two")
    return current | association


def _gate(name: str, probability: object) -> float:
    """The quantile of chi-square with 2 degrees of freedom."""
    if not isinstance(probability, float) or not 0.0 < probability < 1.0:
        raise ConfigError(f"{name}: found {shown(probability)}, allowed: above 0 and below 1")
    return -2.0 * math.log(1.0 - probability)


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
