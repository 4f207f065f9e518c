"""Several runs side by side or in groups: a table of their metrics, and their figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.evaluation.groups import RunTable, Sample, differing, labelled, table_of, usual_grouping
from sixthsense.evaluation.measured_run import numbered_names
from sixthsense.evaluation.results import as_text, html_of, side_by_side
from sixthsense.evaluation.summary import summary
from sixthsense.figures.kinds import plot
from sixthsense.figures.run import Run, load
from sixthsense.record.trace import Trace

if TYPE_CHECKING:
    import pandas as pd

    from sixthsense.evaluation.curves import Over

Compared = Run | Trace | str | Path | RunTable
"""a run, its record, or its folder; a campaign"""

_KEYS = ["outcome", "ate_rmse_m", "heading_rmse_rad", "pose_nees_world_mean", "nis_mean_per_dof", "coverage"]


class Comparison:
    """Several runs for comparison, as returned by `ss.compare`: their table, and their figures.

    A run keeps its record, so that all its figures can be drawn. Of the runs of a campaign there are metrics and the
    errors at keyframes.
    """

    def __init__(self, samples: Sequence[Sample]) -> None:
        """Wrap at least one sample; the order is kept."""
        self.samples = tuple(samples)
        """all runs compared: name, configuration, metrics"""
        self.runs: tuple[Run, ...] = tuple(sample.run for sample in samples if sample.run is not None)
        """those with a record"""
        self.names = [sample.name for sample in samples]

    def frame(self) -> pd.DataFrame:
        """A row per run with index `run`: scene, preset, the parts, seed, and a column per metric.

        NaN where a run lacks the metric; `attrs["units"]` has the units by column.
        """
        return table_of(self.samples)

    def plot(
        self, what: str = "map", by: str | Sequence[str] | None = None, *, over: Over = "time", ax: Any = None
    ) -> Any:
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
        if by is None and len(self.runs) < len(self.samples):
            by = usual_grouping([sample.fields for sample in self.samples])
        return plot(what, self.samples, by, ax, over)

    def _table(self) -> pd.DataFrame:
        """The runs by their most important metrics; of a campaign the groups of its runs."""
        if len(self.runs) == len(self.samples):
            frame = self.frame()
            return frame[[key for key in _KEYS if key in frame]].round(4)
        by = usual_grouping([sample.fields for sample in self.samples])
        found = [sample.curves() for sample in self.samples]
        return summary(self.frame().reset_index(), by, [None if one is None else one["nees"] for one in found])

    def metrics(self) -> pd.DataFrame:
        """All metrics, a row each in groups, as text: a column per run, unit and meaning."""
        return as_text(side_by_side({one.name: one.metrics for one in self.samples}))

    def __len__(self) -> int:
        return len(self.samples)

    def __iter__(self) -> Iterator[Run]:
        return iter(self.runs)

    def __repr__(self) -> str:
        return str(self._table().to_string(na_rep=""))

    def _repr_html_(self) -> str:
        if len(self.runs) < len(self.samples):
            return html_of(self._table())
        return html_of(self.metrics())


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
    if isinstance(runs, (Run, Trace, str, Path)) or not isinstance(runs, RunTable | Iterable):
        raise InputError("runs", f"found {shown(runs)}", "a list of runs or folders, or a mapping of them")
    found = list(runs.values()) if isinstance(runs, Mapping) else [runs] if isinstance(runs, RunTable) else list(runs)
    opened = [one if isinstance(one, RunTable) else _opened(one) for one in found]
    names = list(map(str, runs)) if isinstance(runs, Mapping) else _distinguishing_names(found, opened)
    numbered = iter(numbered_names([name for name, one in zip(names, opened, strict=True) if isinstance(one, Run)]))
    samples: list[Sample] = []
    for name, one in zip(names, opened, strict=True):
        samples += [one.sample(next(numbered))] if isinstance(one, Run) else one.samples(name)
    if not samples:
        raise InputError("runs", "found none", "one or more")
    return Comparison(samples)


def _opened(run: Any) -> Run:
    """The run of a record or a folder; InputError, with the call that loads it, for the folder of a campaign."""
    if isinstance(run, (str, Path)):
        if (Path(run) / "campaign.toml").is_file():
            raise InputError("runs", f"found the folder of a campaign, {run}", f"ss.load_campaign({str(run)!r})")
        return load(run)
    if not isinstance(run, Run | Trace):
        raise InputError("runs", f"found {shown(run)}", "runs, folders of runs, or campaigns")
    return run if isinstance(run, Run) else Run(run.name or "run", run)


def _distinguishing_names(given: Sequence[Compared], opened: Sequence[Run | RunTable]) -> list[str]:
    """A name per run from the configuration fields that differ; a campaign's own, and that of a folder."""
    fields = [
        one.sample(one.trace.name).fields if isinstance(one, Run) and isinstance(source, Run | Trace) else {}
        for source, one in zip(given, opened, strict=True)
    ]
    # The name already contains the scene.
    apart = [name for name in differing([table for table in fields if table]) if name != "scene"][:4]
    labels = [" · ".join(labelled(name, table.get(name)) for name in apart) if table else "" for table in fields]
    return [label or one.name or "run" for label, one in zip(labels, opened, strict=True)]
