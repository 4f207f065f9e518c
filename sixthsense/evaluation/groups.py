"""Runs in groups: which fields tell them apart, and the spread of their errors over the runs of a group."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.config import Config, as_table
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import KINDS
from sixthsense.config.section import shown
from sixthsense.core.geometry import Array
from sixthsense.evaluation.curves import Curves, Over

LABELS = ("scene", "preset", *(parts.kind for parts in KINDS), "seed")
"""fields of the configuration that a table of several runs has as columns"""
Fields = Mapping[str, Any]
"""of a run: the fields of its configuration by dotted names, and its name"""
RUN = "run"
"""column of the names under which runs and campaigns are compared"""
MOST_GROUPS = 12

_POINTS = 200  # of a curve of several runs
_PLAIN = ("scene", "estimator", "front_end", "preset", "planner", "task")  # whose value says which field it is
_MOST_NAMED = 4


@dataclass(frozen=True)
class Sample:
    """One of the runs that are compared."""

    name: str
    """of the run, or of the campaign that it is of"""
    config: Config
    """its configuration"""
    measure: Callable[[], Mapping[str, Any]]
    """returns its metrics"""
    curves: Callable[[], Curves | None]
    """returns its errors along its way, if they are known"""

    @cached_property
    def metrics(self) -> Mapping[str, Any]:
        """Its metrics, measured when they are first asked for."""
        return self.measure()

    @cached_property
    def fields(self) -> Fields:
        """As `fields_of` has them."""
        return fields_of(self.name, self.config)


class RunTable(ABC):
    """A table of runs that can be compared, such as a campaign."""

    name: str
    """by which its runs are told from those of another"""

    @abstractmethod
    def samples(self, name: str) -> Sequence[Sample]:
        """Its runs, under a name."""


@dataclass(frozen=True, slots=True)
class Group:
    """Runs with the same values of the fields by which they are grouped."""

    name: str
    """these values"""
    samples: tuple[Sample, ...]
    """at least one"""

    def curves(self) -> list[Curves]:
        """Of the runs whose errors are known."""
        return [found for sample in self.samples if (found := sample.curves()) is not None]

    def metric(self, key: str) -> Array:
        """(N,) of the runs that have this metric."""
        values = (sample.metrics.get(key) for sample in self.samples)
        found = np.array([value for value in values if isinstance(value, (int, float))], dtype=np.float64)
        return found[np.isfinite(found)]


def grouped(samples: Sequence[Sample], by: str | Sequence[str]) -> list[Group]:
    """The runs by their values of one or several fields, in the order of their first runs.

    Raises InputError for a field that no run has, with the nearest name, and for more than 12 groups.
    """
    names = tuple(by) if isinstance(by, (list, tuple)) else (by,)
    tables = [sample.fields for sample in samples]
    known = list(dict.fromkeys(name for table in tables for name in table))
    for name in names or ("",):
        if name not in known:
            others = ", or another field of the configuration"
            raise InputError("by", f"found {shown(name)}", ", ".join((RUN, *LABELS)) + others, nearest(name, known))
    members: dict[str, list[Sample]] = {}
    for sample, table in zip(samples, tables, strict=True):
        members.setdefault(" · ".join(labelled(name, table.get(name)) for name in names), []).append(sample)
    if len(members) > MOST_GROUPS:
        raise InputError("by", f"found {len(members)} groups by {', '.join(names)}", f"at most {MOST_GROUPS}")
    return [Group(name, tuple(found)) for name, found in members.items()]


def differing(runs: Sequence[Fields], names: Iterable[str] | None = None) -> list[str]:
    """The fields that are not equal in all runs; of `names`, if given."""
    known = dict.fromkeys(name for fields in runs for name in fields) if names is None else names
    return [name for name in known if len({repr(fields.get(name)) for fields in runs}) > 1]


def usual_grouping(runs: Sequence[Fields]) -> list[str]:
    """The columns but the seed that tell runs apart; the estimator if none does."""
    return differing(runs, [name for name in (RUN, *LABELS) if name != "seed"]) or ["estimator"]


def differences(runs: Sequence[Fields]) -> str:
    """What differs between the runs and what they have in common, for the title of a figure."""
    apart = [name for name in differing(runs) if name != RUN]
    if "preset" in apart:  # without the fields that each preset sets
        presets = dict.fromkeys(fields["preset"] for fields in runs)
        by_preset = [[fields for fields in runs if fields["preset"] == preset] for preset in presets]
        apart = [name for name in apart if name in LABELS or any(differing(alike, [name]) for alike in by_preset)]
    apart.sort(key=lambda name: name not in LABELS)
    counts = [f"{name} ({len({repr(fields.get(name)) for fields in runs})})" for name in apart[:_MOST_NAMED]]
    counts += [f"{len(apart) - _MOST_NAMED} more"] if len(apart) > _MOST_NAMED else []
    shared = [name for name in (*_PLAIN, "seed", "max_time") if name not in apart and runs[0].get(name) is not None]
    parts = {"differs": counts, "same": [labelled(name, runs[0][name]) for name in shared]}
    return " — ".join(f"{title}: {', '.join(words)}" for title, words in parts.items() if words)


def labelled(name: str, value: Any) -> str:
    """The value of a field as a label: alone where it says which field it is, with the field's name elsewhere."""
    if name == "scene":
        return Path(value).stem
    return str(value) if name in (RUN, *_PLAIN) else f"{name} {value}"


def fields_of(name: str, config: Config) -> Fields:
    """All fields of a configuration by dotted names, and the `name` of the run."""
    return {RUN: name} | flat(as_table(config))


def flat(table: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """The settings of a nested table by dotted names."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        found |= flat(value, f"{path}{key}.") if isinstance(value, Mapping) else {path + key: value}
    return found


def resampled(runs: Sequence[Curves], quantity: str, over: Over) -> tuple[Array, Array]:
    """A quantity of several runs at the same places: (P,) times or distances, and (N, P) values.

    Each value is that of the run's latest scan that has one, and NaN before its first and after its last scan. The
    places go as far as more than half of the runs do, and a run has a value at each. `quantity` is a field of `Curves`.
    """
    axes = [one.over(over) for one in runs]
    reached = sorted(float(axis[-1]) for axis in axes)[(len(axes) - 1) // 2]
    places = np.linspace(0.0, reached, _POINTS)
    values = np.full((len(runs), _POINTS), np.nan)
    for row, axis, one in zip(values, axes, runs, strict=True):
        known = np.flatnonzero(np.isfinite(getattr(one, quantity)))
        latest = np.searchsorted(axis[known], places, side="right") - 1
        inside = (latest >= 0) & (places <= axis[-1])
        row[inside] = getattr(one, quantity)[known[latest[inside]]]
    known = np.isfinite(values).any(axis=0)
    return places[known], values[:, known]
