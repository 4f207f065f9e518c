"""Making the runs that are missing in a campaign's folder; `ss.campaign`, `ss.load_campaign`, and their result."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Unpack

from pydantic import Field

from sixthsense.campaigns.engine import Processes, carry_out
from sixthsense.campaigns.folder import CampaignRows, check_folder, read_folder, save_folder
from sixthsense.campaigns.plan import (
    ALWAYS,
    AXES,
    FAILED,
    CampaignPlan,
    campaign_of,
    described,
    failed_row,
    one_line,
    plan,
    run_row,
    with_parts,
)
from sixthsense.config import Config, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.config.files import path_of
from sixthsense.config.parts import KINDS, import_again, searched
from sixthsense.config.section import Count, checked
from sixthsense.config.tree import task_of
from sixthsense.evaluation.groups import LABELS, RunTable, Sample
from sixthsense.evaluation.results import html_of
from sixthsense.evaluation.summary import summary
from sixthsense.record.writing import FolderLock
from sixthsense.running.progress import progress_bar
from sixthsense.running.warmup import prepare

if TYPE_CHECKING:
    import pandas as pd

    from sixthsense.config.fields import CampaignFields

_log = logging.getLogger(__name__)


def complete(
    campaign: CampaignPlan,
    runs: Mapping[str, Config],
    out: Path,
    workers: int | None = None,
    *,
    retry_failed: bool = False,
    progress: bool | None = None,
    executor: Executor | None = None,
) -> None:
    """Make those of the planned runs, by hash, that have no row in the campaign's folder `out`.

    They are made by `workers` processes of this machine, by default one per processor, or as many at a time in an
    `executor`. With `retry_failed` the runs that raised are repeated. `progress` is whether a bar is shown. How many
    runs there are is logged. Each row is written when its run ends, also if an interrupt follows. Raises InputError for
    the folder of another campaign, and for an executor whose processes would make other runs; FolderInUseError;
    OSError that names a file.
    """
    check_folder(out, campaign)
    with FolderLock(out):
        saved, rows = check_folder(out, campaign), CampaignRows(out)
        known = rows.rows.read()
        done = {key for key, row in known.items() if not (retry_failed and row["outcome"] == FAILED)}
        missing = {key: config for key, config in runs.items() if key not in done}
        if not missing:
            save_folder(out, saved)
            _log.info(f"all {len(runs)} runs are already in {out}/")
            return
        with _pool(executor, campaign, workers) as pool:
            save_folder(out, saved)
            existing = f", {len(runs) - len(missing)} already in {out}/" if len(missing) < len(runs) else ""
            _log.info(f"{len(runs)} runs{existing}; {pool.workers} worker{'s' * (pool.workers != 1)}")
            with progress_bar(progress, total=len(missing), desc="campaign", unit=" runs", leave=False) as bar:
                try:
                    for key, future in carry_out(pool, run_row, missing):
                        error = future.exception()
                        rows.add(future.result() if error is None else failed_row(missing[key], error))
                        bar.update()
                except KeyboardInterrupt:
                    count = f"{len(runs.keys() & rows.rows.read().keys())} of {len(runs)} runs are in {out}/"
                    _log.warning(f"interrupted, {count}, the same command makes the missing ones")
                    raise


def _pool(executor: Executor | None, campaign: CampaignPlan, workers: int | None) -> Any:
    """Processes of this machine, or an executor of the caller's, whose workers have been checked, in their place."""
    pool = Processes(workers, partial(import_again, dict(searched)))
    if executor is None:
        prepare()  # once, not by each worker
        return pool
    own = described(campaign)
    for future in [executor.submit(described, campaign) for _ in range(pool.workers)]:
        try:
            found = future.result()
        except Exception as error:
            raise InputError("executor", f"found no usable sixthsense ({one_line(error)})", str(own)) from None
        if other := {name: value for name, value in found.items() if value != own[name]}:
            raise InputError("executor", f"found {other}", str({name: own[name] for name in other}))
    return nullcontext(SimpleNamespace(submit=executor.submit, workers=pool.workers))


def campaign(
    scenes: str | Path | Sequence[str | Path],
    *,
    seeds: Iterable[int],
    out: str | Path,
    workers: int | None = None,
    retry_failed: bool = False,
    progress: bool | None = None,
    executor: Executor | None = None,
    **fields: Unpack[CampaignFields],
) -> Campaign:
    """Run every scene with every preset, estimator, other part and seed, and keep a row of metrics for each run.

        done = ss.campaign("apartment", seeds=range(5), estimator=["ekf", "isam2"], task="tour", max_time=60, out="mc")
        ss.compare(done).plot("error", by="estimator")

    The same call resumes a campaign that was interrupted, or makes the runs that are missing after seeds were added.
    Ctrl-C ends it with KeyboardInterrupt; the rows so far are kept, and `ss.load_campaign(out)` reads them.

    Parameters
    ----------
    scenes
        One or several: a shipped scene's name, or a file (.toml or map_server .yaml).
    seeds
        Whole numbers, such as `range(20)`.
    out
        Folder to write, new or of this campaign: campaign.toml, rows.jsonl and curves/.
    workers, executor
        Number of runs at a time, by default one per processor, each in a process; an executor in place of these
        processes, as `concurrent.futures` has it or a Dask client's `get_executor()`.
    retry_failed, progress
        Whether runs that raised are repeated; whether a bar is shown, by default in a notebook and at a terminal.
    **fields
        Fields of the configuration by name, for all runs. `preset` and the parts (`estimator`, `front_end`, `planner`,
        ...) may be lists: the campaign compares their values. Parts of your own must be of modules that the workers
        can import.

    Raises
    ------
    InputError
        In one line, before anything is written: a value that is not allowed; the folder of another campaign or of a
        run; an executor whose workers would make other runs.

    """
    given = dict(fields)
    workers = checked("workers", Annotated[int | None, Field(ge=1, le=1024)], workers)
    for name in ("scene", "seed"):
        if name in given:
            raise InputError(name, "found for a campaign", f"{name}s")
    axes = {axis: _several(axis, given.pop(axis)) for axis in AXES if axis in given}
    for parts in KINDS:
        if parts.kind in axes:
            axes[parts.kind] = tuple(map(parts.name_of, axes[parts.kind]))
    axes["scene"] = tuple(map(str, checked("scenes", tuple[str | Path, ...], _several("scenes", scenes))))
    each = tuple(seeds) if isinstance(seeds, Iterable) and not isinstance(seeds, str) else seeds
    every = checked("seeds", Annotated[tuple[Count, ...], Field(min_length=1)], each)
    planned = campaign_of(axes, every, given, task_of(given))
    options: dict[str, Any] = {"retry_failed": retry_failed, "progress": progress, "executor": executor}
    complete(planned, plan(planned), path_of("out", out), workers, **options)
    return Campaign(out)


def _several(name: str, value: Any) -> tuple[Any, ...]:
    """One value or several as a tuple; InputError for none."""
    values = tuple(value) if isinstance(value, (list, tuple)) else (value,)
    found: tuple[Any, ...] = checked(name, Annotated[tuple[Any, ...], Field(min_length=1)], values)
    return found


class Campaign(RunTable):
    """The runs of a running or finished campaign, read from its folder whenever they are asked for.

    `frame()` is their table; `ss.compare(campaign)` draws figures of them. It prints as a table of means.
    """

    def __init__(self, folder: str | Path) -> None:
        """Open a folder; raises InputError for one that is not a campaign's."""
        self.folder = path_of("folder", folder)
        """with campaign.toml, rows.jsonl and curves/"""
        self.name = self.folder.absolute().name
        self._fields = read_folder(self.folder).fields
        self._rows = CampaignRows(self.folder)

    def frame(self) -> pd.DataFrame:
        """A row per run, sorted: scene, preset, the parts, seed, and a column per metric.

        A metric that a run lacks is NaN. A run that raised has the outcome "error" and the reason in the column
        `error`. Raises InputError for a table that cannot be read.
        """
        return self._rows.frame()

    def samples(self, name: str) -> list[Sample]:
        """The runs for a comparison, with their errors along their ways."""
        frame, curves = self.frame(), self._rows.curves()
        found = []
        for row in frame.to_dict("records"):
            values = {axis: row[axis] for axis in AXES}
            base = merge(preset(values.pop("preset")), self._fields)
            config = merge(with_parts(base, self._fields, **values), {"seed": row["seed"]})
            metrics = {key: value for key, value in row.items() if key not in LABELS and value == value}
            found.append(Sample(name, config, partial(dict, metrics), partial(curves.get, row["config_hash"])))
        return found

    def summary(self) -> pd.DataFrame:
        """A row per scene, preset and parts, which are the index, with means and outcomes; empty without runs."""
        frame, curves = self.frame(), self._rows.curves()
        found = [curves.get(key) for key in frame["config_hash"]] if len(frame) else []
        axes = [axis for axis in AXES if axis in ALWAYS or frame[axis].nunique() > 1]
        return summary(frame, axes, [None if one is None else one["nees"].to_numpy() for one in found])

    def __len__(self) -> int:
        return len(self._rows.rows.read())

    def __repr__(self) -> str:
        return "\n".join([f"<Campaign {self.name}: {len(self)} runs>", self.summary().to_string()])

    def _repr_html_(self) -> str:
        return html_of(self.summary())


def load_campaign(folder: Path | str) -> Campaign:
    """Open a running or finished campaign: `.frame()` has a row per run, `ss.compare` draws figures.

        ss.load_campaign("mc").frame().groupby("estimator")["ate_rmse_m"].median()

    Raises InputError for a folder that is not a campaign's.
    """
    return Campaign(folder)
