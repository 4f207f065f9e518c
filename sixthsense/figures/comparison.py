"""Several runs side by side or in groups: a table of their metrics, and their figures."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, overload

from sixthsense.config.errors import InputError, pandas
from sixthsense.config.section import shown
from sixthsense.evaluation.groups import LABELS, RUN, RunTable, Sample, differing, fields_of, labelled, usual_grouping
from sixthsense.evaluation.measured_run import numbered_names
from sixthsense.evaluation.results import metrics_table
from sixthsense.evaluation.summary import summary
from sixthsense.evaluation.tables import digits, html_table, text_table
from sixthsense.figures.panels import figure, group_figure
from sixthsense.figures.run import Run, load
from sixthsense.record.trace import Trace

if TYPE_CHECKING:
    import pandas as pd

    from sixthsense.core.picture import Picture
    from sixthsense.evaluation.curves import Over
    from sixthsense.figures.canvas import OnAxes

    By = str | Sequence[str] | None

Compared = Run | Trace | str | Path | RunTable
"""a run, its record, or its folder; a campaign"""

_KEYS = ("outcome", "ate_rmse_m", "heading_rmse_rad", "pose_nees_world_mean", "nis_mean_per_dof", "coverage")


class Comparison:
    """Several runs for comparison, as returned by `ss.compare`: their table, and their figures.

    A run keeps its record, so that all its figures can be drawn. Of the runs of a campaign there are metrics and the
    errors at keyframes.
    """

    def __init__(self, samples: Sequence[Sample], runs: Sequence[Run] = ()) -> None:
        """Wrap at least one sample; `runs` are those of them that have a record. The order is kept."""
        self.samples = tuple(samples)
        """all runs compared: name, configuration, metrics"""
        self.runs = tuple(runs)
        """those with a record"""
        self.names = [sample.name for sample in samples]

    def frame(self) -> pd.DataFrame:
        """A row per run with index `run`: scene, preset, the parts, seed, and a column per metric.

        NaN where a run lacks the metric; InputError without pandas.
        """
        rows = [
            {name: getattr(sample.config, name) for name in LABELS} | dict(sample.metrics) for sample in self.samples
        ]
        return pandas().DataFrame(rows, index=pandas().Index(self.names, name=RUN))

    @overload
    def plot(self, what: str = ..., by: By = ..., *, over: Over = ..., ax: None = ...) -> Picture: ...
    @overload
    def plot(self, what: str = ..., by: By = ..., *, over: Over = ..., ax: OnAxes) -> None: ...
    def plot(
        self, what: str = "map", by: By = None, *, over: Over = "time", ax: OnAxes | None = None
    ) -> Picture | None:
        """A figure of at most 12 runs side by side, or of groups of any number of runs.

            ss.compare(runs).plot("error", by="estimator", over="distance")

        Parameters
        ----------
        what
            Side by side the name of a figure as of `Run.plot`. Of groups "error", the median over the runs of a group
            and the band of 10 to 90 %; "nees", averaged over them, with the 95 % band of such an average; "rpe", the
            relative pose error over 1, 2, 5 and 10 m of path.
        by
            Column of `frame()`, or any field of the configuration such as "laser.beams", or several of them: runs with
            equal values are a group and have a colour. "run" groups by name. Runs of campaigns are always grouped, by
            default by the columns that differ.
        over
            "time" or "distance" travelled, for "error" and "nees".
        ax
            As of `Run.plot`.

        Raises
        ------
        InputError
            For an unknown name or column, with the nearest one, and as of `Run.plot`.

        """
        if by is None and len(self.runs) == len(self.samples):
            return figure(what, self.runs, over, ax)
        columns = usual_grouping([sample.fields for sample in self.samples]) if by is None else by
        return group_figure(what, self.samples, columns, over, ax)

    def _summary(self) -> list[list[str]]:
        by = usual_grouping([sample.fields for sample in self.samples])
        found = [sample.curves() for sample in self.samples]
        return summary(self.frame().reset_index(), by, [None if one is None else one.nees for one in found])

    def __len__(self) -> int:
        return len(self.samples)

    def __iter__(self) -> Iterator[Run]:
        return iter(self.runs)

    def __repr__(self) -> str:
        if len(self.runs) < len(self.samples):
            return text_table(self._summary())
        rows = [["run", *_KEYS]]
        rows += [
            [name, *(digits(run.metrics.get(key, "")) for key in _KEYS)]
            for name, run in zip(self.names, self.runs, strict=True)
        ]
        return text_table(rows)

    def _repr_html_(self) -> str:
        title = f"<b>{len(self.samples)} run{'s' * (len(self.samples) > 1)}</b>"
        if len(self.runs) < len(self.samples):
            head, *rows = self._summary()
            return f"<div>{title}{html_table(head, rows)}</div>"
        titles = "".join(f"<div>{html.escape(run.title)}</div>" for run in self.runs)
        table = metrics_table(["metric", *self.names], [run.metrics for run in self.runs])
        return f"<div>{title}<details><summary>titles</summary>{titles}</details>{table}</div>"


def compare(runs: Iterable[Compared] | Mapping[str, Compared] | RunTable) -> Comparison:
    """Compare runs and campaigns, also of different scenes: a table (`.frame()`) and figures (`.plot("error")`).

        ss.compare({name: ss.run("office", estimator=name) for name in ("ekf", "isam2")})
        ss.compare(ss.load_campaign("mc")).plot("error", by="estimator")

    Parameters
    ----------
    runs
        Runs, folders of runs, and campaigns: one campaign, several of them in order, or a mapping from names to them.
        Without a mapping, the name of a folder is used, and for a run the fields of its configuration that differ from
        those of the other runs.

    Raises
    ------
    InputError
        For no run, for an object that is not a run, and for a folder that is not a run folder.

    """
    if isinstance(runs, (str, Path)):
        _refuse_campaign(runs)
    if isinstance(runs, (Run, Trace, str, Path)) or not isinstance(runs, RunTable | Iterable):
        raise InputError("runs", f"found {shown(runs)}", "a list of runs or folders, or a mapping of them")
    if isinstance(runs, RunTable):
        runs = [runs]
    if isinstance(runs, Mapping):
        given = [(str(name), run) for name, run in runs.items()]
    else:
        found = list(runs)
        given = list(zip(_distinguishing_names(found), found, strict=True))
    opened = [(name, one) if isinstance(one, RunTable) else (name, _with_name(name, one)) for name, one in given]
    with_record = [one for _, one in opened if isinstance(one, Run)]
    names = iter(numbered_names(with_record))
    samples: list[Sample] = []
    for name, one in opened:
        samples += [one.sample(next(names))] if isinstance(one, Run) else one.samples(name)
    if not samples:
        raise InputError("runs", "found none", "one or more")
    return Comparison(samples, with_record)


def _with_name(name: str, run: Compared) -> Run:
    """The run with the given name; with its own name if that is empty."""
    if isinstance(run, Trace):
        return Run(name or run.name or "run", run)
    if isinstance(run, (str, Path)):
        _refuse_campaign(run)
        run = load(run)
    if not isinstance(run, Run):
        raise InputError("runs", f"found {shown(run)}", "runs, folders of runs, or campaigns")
    return Run(name or run.name or "run", run.trace, run.metrics, run.folder, run.missing)


def _refuse_campaign(folder: str | Path) -> None:
    """Raise InputError, with the call that loads it, for the folder of a campaign."""
    if (Path(folder) / "campaign.toml").is_file():
        allowed = f"ss.load_campaign({str(folder)!r})"
        raise InputError("runs", f"found the folder of a campaign, {folder}", allowed)


def _distinguishing_names(runs: Sequence[Compared]) -> list[str]:
    """A name per run from the configuration fields that differ; a campaign's own, and empty for a folder."""
    traces = [run.trace if isinstance(run, Run) else run if isinstance(run, Trace) else None for run in runs]
    tables = [{} if trace is None else fields_of(trace.name, trace.config) for trace in traces]
    # The name already contains the scene.
    apart = [name for name in differing([table for table in tables if table]) if name != "scene"][:4]
    names = []
    for run, trace, table in zip(runs, traces, tables, strict=True):
        label = " · ".join(labelled(name, table.get(name)) for name in apart) if table else ""
        own = run.name if isinstance(run, RunTable) else "" if trace is None else trace.name or "run"
        names.append(label or own)
    return names
