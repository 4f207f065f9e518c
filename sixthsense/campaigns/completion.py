"""Making the runs of a campaign that are missing in its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sixthsense.campaigns.cluster import check_workers, connect, execute
from sixthsense.campaigns.folder import check_folder, check_rows, save_folder
from sixthsense.campaigns.plan import CampaignPlan, PlannedRun
from sixthsense.campaigns.rows import Rows
from sixthsense.campaigns.worker import FAILED
from sixthsense.record.writing import FolderLock
from sixthsense.running.progress import progress_bar
from sixthsense.running.warmup import COMPILING, is_compiled


@dataclass(frozen=True, slots=True)
class Execution:
    """Where runs are made, and what is shown meanwhile."""

    workers: int | None = None
    """number of local processes; None: one per processor"""
    scheduler: str | None = None
    """address of a Dask scheduler to use instead"""
    retry_failed: bool = False
    """repeat the runs that raised"""
    progress: bool | None = None
    """whether a bar is shown; None: in a notebook and at an interactive terminal"""
    say: Callable[[str], object] = lambda line: None
    """is told how many runs there are, and where"""


def complete(campaign: CampaignPlan, runs: Mapping[str, PlannedRun], out: Path, execution: Execution) -> None:
    """Make those of the planned runs, by hash, that have no row in the campaign's folder `out`.

    Each row is written when its run ends, also if an interrupt follows. Raises CampaignError for the folder of another
    campaign, for workers that will not do, and if the scheduler is lost; FolderInUseError; OSError that names a file.
    """
    with FolderLock(out):
        saved = check_folder(out, campaign)
        rows = Rows(out)
        known = rows.summaries()
        check_rows(out, runs, known)
        done = {row["config_hash"] for row in known if not (execution.retry_failed and row["outcome"] == FAILED)}
        missing = {key: run for key, run in runs.items() if key not in done}
        if missing:
            _execute(campaign, saved, rows, (out, len(runs), missing), execution)
        else:
            save_folder(out, campaign, saved)
            execution.say(f"all {len(runs)} runs are already in {out}/")


def _execute(
    campaign: CampaignPlan,
    saved: Mapping[str, Any] | None,
    rows: Rows,
    task: tuple[Path, int, Mapping[str, PlannedRun]],
    execution: Execution,
) -> None:
    out, total, missing = task
    if not is_compiled():
        execution.say(COMPILING)
    with connect(execution.scheduler, execution.workers) as client:
        workers = check_workers(client, campaign.scenes)
        save_folder(out, campaign, saved)
        existing = f", {total - len(missing)} already in {out}/" if len(missing) < total else ""
        execution.say(f"{total} runs{existing}; {workers} workers; dashboard {client.dashboard_link}")
        with progress_bar(execution.progress, total=len(missing), desc="campaign", unit=" runs", leave=False) as bar:

            def on_row(row: dict[str, Any]) -> None:
                rows.add(row)
                bar.update()

            execute(client, missing, on_row)
