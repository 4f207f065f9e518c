"""Runs that are over: of one's own or from folders, each with its name and the metrics that it measured."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown, shown_name
from sixthsense.evaluation.results import Metrics
from sixthsense.record.trace import Trace

MOST_RUNS = 12  # more panels than that are too small to be read


class ReportError(InputError):
    """One line that names the folder and what is wrong with it."""


@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A run as its folder tells of it."""

    name: str
    """of the folder, without `.partial`"""
    trace: Trace
    """what the run saw, believed and did"""
    metrics: Metrics
    """as the run measured them; of a run that was killed, what can still be measured"""
    folder: Path | None = None
    """where it is; None of one that is not from a folder"""

    @property
    def title(self) -> str:
        """What the run was, and how it ended."""
        config = self.trace.config
        named = self.trace.scene is None or Path(config.scene).suffix or config.scene == self.name
        of = "" if named else f"{config.scene} · "
        return f"{self.name}: {of}{config.estimator} · {config.preset} · seed {config.seed} · {self.outcome}"

    @property
    def outcome(self) -> str:
        """Why it ended, as far as that is known."""
        return str(self.metrics.get("outcome", self.trace.outcome)) or "running"


def check_folders(folders: Sequence[Path | str]) -> None:
    """Raise ReportError, naming it, for a folder that is no run's, and for more folders than a report holds."""
    if not 1 <= len(folders) <= MOST_RUNS:
        raise ReportError(f"runs: found {len(folders)}, allowed: 1 to {MOST_RUNS}")
    for folder in map(Path, folders):
        if not (folder / "config.toml").is_file():
            found = "no config.toml in it" if folder.is_dir() else "no such folder"
            raise ReportError(f"{folder}: found {found}, allowed: the folder of a run")


def load_run(folder: Path | str) -> FinishedRun:
    """Read a run's folder, finished or killed; raises an InputError that names the folder if it is none."""
    folder = Path(folder)
    check_folders([folder])
    trace = Trace.load(folder)
    file = folder / "metrics.json"
    if not file.is_file():
        # The clock of a replay says nothing of the run: what is timed is left out.
        timed = ("wall_time_s", "realtime_factor", "scan_ms", "stage_ms")
        measured = {key: value for key, value in trace.metrics.items() if not key.startswith(timed)}
        return FinishedRun(_name(folder), trace, Metrics(measured), folder)
    try:
        metrics = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        raise ReportError(f"{file}: found no JSON, allowed: a run's metrics") from None
    if not isinstance(metrics, dict):
        raise ReportError(f"{file}: found no table, allowed: a run's metrics")
    for key, value in metrics.items():
        if not isinstance(value, str if key == "outcome" else (int, float)):
            kind = "words" if key == "outcome" else "a number"
            raise ReportError(f"{file}: {shown_name(key)}: found {shown(value)}, allowed: {kind}")
        if isinstance(value, int) and value.bit_length() > 1000:  # more than a float holds
            raise ReportError(f"{file}: {shown_name(key)}: found {shown(value)}, allowed: a number")
    return FinishedRun(_name(folder), trace, Metrics(metrics), folder)


def _name(folder: Path) -> str:
    return folder.resolve().name.removesuffix(".partial")


def as_finished(trace: Trace, name: str = "") -> FinishedRun:
    """A run of this process; its name is the trace's own where none is given."""
    return FinishedRun(name or trace.name or "run", trace, trace.metrics)


def distinct(runs: Sequence[FinishedRun]) -> list[str]:
    """The runs' names, numbered where two folders share one."""
    names = [run.name for run in runs]
    return [f"{name} ({k + 1})" if names.count(name) > 1 else name for k, name in enumerate(names)]
