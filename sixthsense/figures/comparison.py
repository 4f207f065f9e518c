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
    """Runs that cannot be compared, in one line."""


class Comparison:
    """Several runs for comparison, as returned by `ss.compare`."""

    def __init__(self, runs: Sequence[Run]) -> None:
        """Wrap at least one run; tables and figures keep the order."""
        self.runs = tuple(runs)
        self.names = numbered_names(self.runs)

    def frame(self) -> pd.DataFrame:
        """A row per run with index `run`, a column per metric, NaN where a run lacks it; ExtraError without pandas."""
        frame = pandas().DataFrame([dict(run.metrics) for run in self.runs], index=self.names)
        frame.index.name = "run"
        return frame

    def plot(self, what: str = "map") -> Picture:
        """A figure of at most 12 runs side by side; names and errors as of `Run.plot`."""
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
        return f"<div>{title}<details><summary>titles</summary>{titles}</details>{table}</div>"


def compare(runs: Iterable[Compared] | Mapping[str, Compared]) -> Comparison:
    """Compare runs, also of different scenes: a table (`.frame()`) and figures (`.plot("error")`).

        ss.compare({name: ss.run("office", estimator=name) for name in ("ekf", "isam2")})

    Parameters
    ----------
    runs
        Runs or folders of runs, in order, or a mapping from names to them. Without a mapping, the name of a folder is
        used, and for a run the fields of its configuration that differ from those of the other runs.

    Raises
    ------
    InputError
        For no run, for an object that is not a run, and for a folder that is not a run folder.

    """
    if isinstance(runs, (Run, Trace, str, Path)):
        raise ComparisonError(f"runs: found {shown(runs)}, allowed: a list of runs or folders, or a mapping of them")
    if isinstance(runs, Mapping):
        given = [(str(name), run) for name, run in runs.items()]
    else:
        found = list(runs)
        given = list(zip(_distinguishing_names(found), found, strict=True))
    if not given:
        raise ComparisonError("runs: found none, allowed: one or more")
    return Comparison([_with_name(name, run) for name, run in given])


def _with_name(name: str, run: Compared) -> Run:
    """The run with the given name; with its own name if that is empty."""
    if isinstance(run, Trace):
        return Run(name or run.name or "run", run)
    if isinstance(run, (str, Path)):
        run = load(run)
    if not isinstance(run, Run):
        raise ComparisonError(f"runs: found {shown(run)}, allowed: runs, or folders of runs")
    return Run(name or run.name or "run", run.trace, run.metrics, run.folder, run.missing)


def _distinguishing_names(runs: Sequence[Compared]) -> list[str]:
    """A name per run from the configuration fields that differ; empty for a folder, which has a name."""
    traces = [run.trace if isinstance(run, Run) else run if isinstance(run, Trace) else None for run in runs]
    tables = [_flatten(trace.config) | {"name": trace.name} if trace is not None else {} for trace in traces]
    filled = [table for table in tables if table]
    # The name already contains the scene.
    keys = [key for key in dict.fromkeys(key for table in filled for key in table) if key != "scene"]
    differing = [key for key in keys if len({repr(table.get(key)) for table in filled}) > 1]
    labels = [
        " · ".join(_field_label(key, table.get(key)) for key in differing[:4]) if table else "" for table in tables
    ]
    return [
        label or (trace.name or "run" if trace is not None else "") for label, trace in zip(labels, traces, strict=True)
    ]


def _field_label(key: str, value: Any) -> str:
    return str(value) if key in ("name", "estimator", "planner", "preset", "task") else f"{key} {value}"


def _flatten(config: Config) -> dict[str, Any]:
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
