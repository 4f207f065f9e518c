"""Several runs side by side: a table of their metrics, and their figures."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.config import Config, as_table
from sixthsense.config.errors import InputError
from sixthsense.config.extras import pandas
from sixthsense.config.section import shown
from sixthsense.evaluation.measured_run import numbered_names
from sixthsense.evaluation.results import metrics_table
from sixthsense.evaluation.tables import digits, text_table
from sixthsense.figures.panels import figure
from sixthsense.figures.run import Run, load
from sixthsense.record.trace import Trace

if TYPE_CHECKING:
    import pandas as pd

    from sixthsense.figures.picture import Picture

Compared = Run | Trace | str | Path
"""a run, its record, or its folder"""

_KEYS = ("outcome", "ate_rmse_m", "heading_rmse_rad", "pose_nees_world_mean", "nis_mean_per_dof", "coverage")


class ComparisonError(InputError):
    """One line on what cannot be compared."""


class Comparison:
    """Runs side by side; `ss.compare` makes one."""

    def __init__(self, runs: Sequence[Run]) -> None:
        """Take at least one run, in the order in which they are shown."""
        self.runs = tuple(runs)
        self.names = numbered_names(self.runs)

    def frame(self) -> pd.DataFrame:
        """A row per run, index `run`, a column per metric, NaN where it was not measured; ExtraError without pandas."""
        frame = pandas().DataFrame([dict(run.metrics) for run in self.runs], index=self.names)
        frame.index.name = "run"
        return frame

    def plot(self, what: str = "map") -> Picture:
        """Their figures side by side, by the names of `Run.plot`, which says what is raised; of 12 runs at most."""
        return figure(what, self.runs)

    def __len__(self) -> int:
        return len(self.runs)

    def __iter__(self) -> Iterator[Run]:
        return iter(self.runs)

    def __repr__(self) -> str:
        rows = [["run", *_KEYS]]
        rows += [
            [name, *(digits(run.metrics.get(key, "")) for key in _KEYS)]
            for name, run in zip(self.names, self.runs, strict=True)
        ]
        return text_table(rows)

    def _repr_html_(self) -> str:
        title = f"<b>{len(self.runs)} run{'s' * (len(self.runs) > 1)}</b>"
        titles = "".join(f"<div>{html.escape(run.title)}</div>" for run in self.runs)
        table = metrics_table(["metric", *self.names], [run.metrics for run in self.runs])
        return f"<div>{title}<details><summary>what they are</summary>{titles}</details>{table}</div>"


def compare(runs: Iterable[Compared] | Mapping[str, Compared]) -> Comparison:
    """Put runs side by side, whatever their scenes: a table (`.frame()`), and figures (`.plot("error")`).

        ss.compare({name: ss.run("office", estimator=name) for name in ("ekf", "isam2")})

    Parameters
    ----------
    runs
        Runs, or folders of runs, in order; or a mapping from the name each shall have. Without one a folder is called
        by its name, and a run by what its configuration has of its own among them.

    Raises
    ------
    InputError
        For no run at all, for what is none, and for a folder that is no run's.

    """
    if isinstance(runs, (Run, Trace, str, Path)):
        raise ComparisonError(f"runs: found {shown(runs)}, allowed: a list of runs or folders, or a mapping of them")
    if isinstance(runs, Mapping):
        given = [(str(name), run) for name, run in runs.items()]
    else:
        found = list(runs)
        given = list(zip(_names(found), found, strict=True))
    if not given:
        raise ComparisonError("runs: found none, allowed: one or more")
    return Comparison([_renamed(name, run) for name, run in given])


def _renamed(name: str, run: Compared) -> Run:
    """The run under the name that it shall have; without one under its own."""
    if isinstance(run, Trace):
        return Run(name or run.name or "run", run)
    if isinstance(run, (str, Path)):
        run = load(run)
    if not isinstance(run, Run):
        raise ComparisonError(f"runs: found {shown(run)}, allowed: runs, or folders of runs")
    return Run(name or run.name or "run", run.trace, run.metrics, run.folder, run.missing)


def _names(runs: Sequence[Compared]) -> list[str]:
    """Of each run what tells it from the others; of folders nothing, since they have names."""
    traces = [run.trace if isinstance(run, Run) else run if isinstance(run, Trace) else None for run in runs]
    tables = [_leaves(trace.config) | {"name": trace.name} if trace is not None else {} for trace in traces]
    filled = [table for table in tables if table]
    # Where the name tells them apart, so does the scene's, which is the same.
    keys = [key for key in dict.fromkeys(key for table in filled for key in table) if key != "scene"]
    differing = [key for key in keys if len({repr(table.get(key)) for table in filled}) > 1]
    words = [" · ".join(_word(key, table.get(key)) for key in differing[:4]) if table else "" for table in tables]
    return [
        word or (trace.name or "run" if trace is not None else "") for word, trace in zip(words, traces, strict=True)
    ]


def _word(key: str, value: Any) -> str:
    return str(value) if key in ("name", "estimator", "planner", "preset", "task") else f"{key} {value}"


def _leaves(config: Config) -> dict[str, Any]:
    """The fields of a configuration by their dotted names."""
    found: dict[str, Any] = {}

    def walk(table: Mapping[str, Any], path: str) -> None:
        for key, value in table.items():
            if isinstance(value, Mapping):
                walk(value, f"{path}{key}.")
            else:
                found[f"{path}{key}"] = value

    walk(as_table(config), "")
    return found
