"""Runs that are compared: which fields tell them apart, their groups, and their curves at common places."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.config import Config, as_table
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import KINDS
from sixthsense.config.section import shown
from sixthsense.core.geometry import Array

if TYPE_CHECKING:
    import pandas as pd

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
    curves: Callable[[], pd.DataFrame | None]
    """returns its errors along its way, if they are known"""
    run: Any = None
    """with its record, if there is one"""

    @cached_property
    def metrics(self) -> Mapping[str, Any]:
        """Its metrics, measured when they are first asked for."""
        return self.measure()

    @cached_property
    def fields(self) -> Fields:
        """The fields of its configuration by dotted names, and its name."""
        return {RUN: self.name} | flat(as_table(self.config))


class RunTable:
    """A table of runs that can be compared, such as a campaign."""

    name: str
    """by which its runs are told from those of another"""

    def samples(self, name: str) -> Sequence[Sample]:
        """Its runs, under a name."""
        raise NotImplementedError


def table_of(samples: Sequence[Sample]) -> pd.DataFrame:
    """A row per run with index `run`: scene, preset, the parts, seed, and a column per metric; units in `attrs`."""
    import pandas as pd

    from sixthsense.evaluation.results import UNITS

    rows = [{name: getattr(one.config, name) for name in LABELS} | dict(one.metrics) for one in samples]
    frame = pd.DataFrame(rows, index=pd.Index([one.name for one in samples], name=RUN))
    frame.attrs["units"] = {key: UNITS[key] for key in frame if key in UNITS}
    return frame


def grouped(samples: Sequence[Sample], by: str | Sequence[str]) -> dict[str, list[Sample]]:
    """The runs by their values of one or several fields, in the order of their first runs.

    Raises InputError for a field that no run has, with the nearest name, and for more than 12 groups.
    """
    names = tuple(by) if isinstance(by, (list, tuple)) else (by,)
    known = list(dict.fromkeys(name for one in samples for name in one.fields))
    for name in names or ("",):
        if name not in known:
            others = ", or another field of the configuration"
            raise InputError("by", f"found {shown(name)}", ", ".join((RUN, *LABELS)) + others, nearest(name, known))
    groups: dict[str, list[Sample]] = {}
    for one in samples:
        groups.setdefault(" · ".join(labelled(name, one.fields.get(name)) for name in names), []).append(one)
    if len(groups) > MOST_GROUPS:
        raise InputError("by", f"found {len(groups)} groups by {', '.join(names)}", f"at most {MOST_GROUPS}")
    return groups


def numbers(samples: Sequence[Sample], key: str) -> Array:
    """(N,) values of a metric, of the runs that have it as a finite number."""
    values = (sample.metrics.get(key) for sample in samples)
    found = np.array([value for value in values if isinstance(value, (int, float))], dtype=np.float64)
    return found[np.isfinite(found)]


def differing(runs: Sequence[Fields], names: Iterable[str] | None = None) -> list[str]:
    """The fields that are not equal in all runs; of `names`, if given."""
    known = dict.fromkeys(name for fields in runs for name in fields) if names is None else names
    return [name for name in known if len({repr(fields.get(name)) for fields in runs}) > 1]


def usual_grouping(runs: Sequence[Fields]) -> list[str]:
    """The columns but the seed that tell runs apart; the estimator if none does."""
    return differing(runs, [name for name in (RUN, *LABELS) if name != "seed"]) or ["estimator"]


def differences(runs: Sequence[Fields]) -> str:
    """What differs between the runs and what they have in common, for the title of a figure."""
    apart = differing(runs, LABELS)  # a preset stands for the fields that it sets
    apart += [] if "preset" in apart else [name for name in differing(runs) if name not in (RUN, *LABELS)]
    counts = [f"{name} ({len({repr(fields.get(name)) for fields in runs})})" for name in apart[:_MOST_NAMED]]
    shared = [name for name in (*_PLAIN, "seed", "max_time") if name not in apart and runs[0].get(name) is not None]
    parts = {"differs": counts, "same": [labelled(name, runs[0][name]) for name in shared]}
    return " — ".join(f"{title}: {', '.join(words)}" for title, words in parts.items() if words)


def labelled(name: str, value: Any) -> str:
    """The value of a field as a label: alone where it says which field it is, with the field's name elsewhere."""
    if name == "scene":
        return Path(value).stem
    return str(value) if name in (RUN, *_PLAIN) else f"{name} {value}"


def flat(table: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """The settings of a nested table by dotted names."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        found |= flat(value, f"{path}{key}.") if isinstance(value, Mapping) else {path + key: value}
    return found


def resampled(runs: Sequence[pd.DataFrame], quantity: str, over: str) -> pd.DataFrame:
    """A column of the curves of several runs at the same places: a row per place of `over`, a column per run.

    Each value is that of the run's latest scan that has one, and NaN before its first and after its last scan. The
    places go as far as more than half of the runs do, and a run has a value at each.
    """
    import pandas as pd

    reached = sorted(float(one[over].iloc[-1]) for one in runs)[(len(runs) - 1) // 2]
    places = np.linspace(0.0, reached, _POINTS)
    columns = {}
    for k, one in enumerate(runs):
        known = one.dropna(subset=[quantity]).drop_duplicates(over, keep="last").set_index(over)[quantity]
        columns[k] = known.reindex(places, method="ffill").where(places <= one[over].iloc[-1])
    return pd.DataFrame(columns).dropna(how="all")
