"""`ss.campaign`: a campaign from Python."""

from __future__ import annotations

import numbers
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Unpack

from sixthsense.campaigns.completion import Execution, complete
from sixthsense.campaigns.errors import CampaignError
from sixthsense.campaigns.plan import AXES, CampaignPlan, plan, resolve_scenes, shared_fields
from sixthsense.campaigns.result import Campaign
from sixthsense.config import preset
from sixthsense.config.errors import InputError
from sixthsense.config.fields import CampaignFields
from sixthsense.config.names import ESTIMATORS, PLANNERS, Names
from sixthsense.config.section import shown
from sixthsense.config.tree import task_of


def campaign(
    scenes: str | Path | Sequence[str | Path],
    *,
    seeds: Iterable[int],
    out: str | Path,
    workers: int | None = None,
    retry_failed: bool = False,
    progress: bool | None = None,
    **fields: Unpack[CampaignFields],
) -> Campaign:
    """Run every scene with every estimator, preset, planner and seed, and keep a row of metrics for each run.

        done = ss.campaign("apartment", seeds=range(5), estimator=["ekf", "isam2"], task="tour", max_time=60, out="mc")
        ss.compare(done).plot("error", by="estimator")

    It is `sixthsense campaign`: the runs are made by processes on this machine, and the same call resumes a campaign
    that was interrupted, or makes the runs that are missing after seeds or estimators were added. Ctrl-C ends it with
    KeyboardInterrupt; the rows so far are kept, and `ss.load_campaign(out)` reads them.

    Parameters
    ----------
    scenes
        One or several: a shipped scene's name, or a file (.toml, map_server .yaml, .scn).
    seeds
        Whole numbers, such as `range(20)`.
    out
        Folder to write, new or of this campaign: campaign.toml, rows/ and curves/.
    workers
        Number of processes, by default one per processor.
    retry_failed
        Whether runs that raised, whose outcome is "error", are repeated.
    progress
        Whether to show a progress bar; by default in a notebook and at a terminal.
    **fields
        Fields of the configuration by name, for all runs. `estimator`, `preset` and `planner` may be lists: the
        campaign compares their values.

    Raises
    ------
    InputError
        In one line, before anything is written: a scene, field, seed or value that is not allowed; the folder of
        another campaign or of a run; a missing package of the extra `campaign`.

    """
    given: dict[str, Any] = dict(fields)
    try:
        planned = _plan(scenes, seeds, given)
        execution = Execution(_worker_count(workers), None, retry_failed, progress)
        complete(planned, plan(planned), Path(out), execution)
    except InputError as error:  # of the command's options, which begin with --
        raise type(error)(str(error).removeprefix("--")) from None
    return Campaign(out)


def _plan(scenes: str | Path | Sequence[str | Path], seeds: Iterable[int], given: dict[str, Any]) -> CampaignPlan:
    default = preset()
    texts = [scenes] if isinstance(scenes, (str, Path)) else list(scenes)
    if not texts or not all(isinstance(text, (str, Path)) for text in texts):
        raise CampaignError(f"scenes: found {shown(scenes)}, allowed: names or files of scenes, one or several")
    for name in ("scene", "seed"):
        if name in given:
            raise CampaignError(f"{name}: found for a campaign, allowed: {name}s")
    values = {axis: _values(axis, given.pop(axis, getattr(default, axis))) for axis in AXES if axis != "scene"}
    return CampaignPlan(
        scenes=resolve_scenes([str(text) for text in texts]),
        estimators=_of_workers("estimator", values["estimator"], ESTIMATORS),
        presets=values["preset"],
        planners=_of_workers("planner", values["planner"], PLANNERS),
        seeds=_seeds(seeds),
        fields=shared_fields(given, task_of(given)),
    )


def _values(axis: str, value: Any) -> tuple[Any, ...]:
    """One value or several as a tuple without duplicates; CampaignError for none."""
    values = tuple(value) if isinstance(value, (list, tuple)) else (value,)
    if not values:
        raise CampaignError(f"{axis}: found {shown(value)}, allowed: one value or several")
    return tuple(dict.fromkeys(values))


def _of_workers(axis: str, values: tuple[Any, ...], names: Names) -> tuple[Any, ...]:
    """The values; CampaignError for one that only this process knows, since the workers are other processes."""
    for value in values:
        if callable(value) or (value in names and value not in names.shipped):
            known = ", ".join(names.shipped)
            raise CampaignError(f"{axis}: found {shown(value)}, which the workers do not know, allowed: {known}")
    return values


def _seeds(seeds: Any) -> tuple[int, ...]:
    allowed = "allowed: whole numbers of at least 0, such as range(20)"
    if not isinstance(seeds, Iterable) or isinstance(seeds, str):
        raise CampaignError(f"seeds: found {shown(seeds)}, {allowed}")
    found = list(seeds)
    for seed in found or [None]:
        if not isinstance(seed, numbers.Integral) or isinstance(seed, bool) or seed < 0:
            raise CampaignError(f"seeds: found {'none' if seed is None else shown(seed)}, {allowed}")
    return tuple(dict.fromkeys(int(seed) for seed in found))


def _worker_count(workers: int | None) -> int | None:
    if workers is not None and not (isinstance(workers, int) and 1 <= workers <= 1024):
        raise CampaignError(f"workers: found {shown(workers)}, allowed: a whole number from 1 to 1024")
    return workers
