"""A run that is over: its record and its metrics, in memory or from its folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown, shown_name
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.results import Metrics
from sixthsense.record.load import Part, load_record
from sixthsense.record.trace import Trace

MAX_RUNS = 12  # with more the panels of a figure are illegible

_UNKNOWN = {
    Part.KEY_SCANS: ("nis_mean_per_dof", "discarded_share", "prediction_nees", "scan_ms", "stage_ms"),
    Part.END: ("wall_time_s", "realtime_factor", "landmarks_culled", "walls_merged"),
    Part.LANDMARKS: ("landmarks",),
}
"""prefixes of metrics that need this part of the record"""


class ReportError(InputError):
    """One line that names the folder, what was found and what is allowed."""


class MeasuredRun:
    """A record with its metrics, which are measured on demand or stated by its folder."""

    def __init__(
        self,
        name: str,
        trace: Trace,
        metrics: Metrics | None = None,
        folder: Path | None = None,
        missing: Sequence[str] = (),
    ) -> None:
        """Wrap a record; without `metrics` they are measured when they are first asked for."""
        self.name = name
        """of the scene, the log or the folder"""
        self.trace = trace
        """the record: what the run saw, estimated and did"""
        self.folder = folder
        """where it is kept; None of a run that is in memory only"""
        self.missing = tuple(missing)
        """what its folder lacks, a phrase each that names the file; `ss.replay(folder)` estimates it again"""
        self._metrics = metrics

    @property
    def metrics(self) -> Metrics:
        """Errors, consistency, coverage and timing by flat keys, with units; what cannot be measured is left out.

        A dictionary that shows itself as a table; `metrics.frame()` is one of pandas. They are computed once, or are
        those that the folder states.
        """
        measured = measure(self.trace) if self._metrics is None else self._metrics
        if self.trace.outcome:
            self._metrics = measured
        return Metrics(measured)

    @property
    def title(self) -> str:
        """Name, scene, estimator, preset, seed and outcome in one line."""
        config = self.trace.config
        named = self.trace.scene is None or Path(config.scene).suffix or config.scene == self.name
        of = "" if named else f"{config.scene} · "
        return f"{self.name}: {of}{config.estimator} · {config.preset} · seed {config.seed} · {self.outcome}"

    @property
    def outcome(self) -> str:
        """Why it ended, as far as that is known."""
        stated = None if self._metrics is None else self._metrics.get("outcome")
        return str(stated or self.trace.outcome) or "running"

    def __repr__(self) -> str:
        config = self.trace.config
        of = f"{self.name or 'a run'}, {config.estimator}, {config.preset}, seed {config.seed}"
        lacks = f"; missing: {', '.join(self.missing)}" if self.missing else ""
        return f"<{type(self).__name__} of {of}: {self.outcome}, {len(self.trace.stamps_ns)} scans{lacks}>"

    @classmethod
    def read(cls, folder: Path | str) -> Self:
        """Read a run folder without estimating again; InputError for one that is no run folder, or is damaged."""
        folder = Path(folder)
        check_folders([folder])
        loaded = load_record(folder)
        missing = [part.value for part in loaded.missing]
        file = folder / "metrics.json"
        if file.exists():
            metrics = _stated(file)
        else:
            missing.append("the metrics at the run's end (metrics.json)")
            unknown = tuple(start for part in loaded.missing for start in _UNKNOWN.get(part, ()))
            metrics = Metrics({k: v for k, v in measure(loaded.trace).items() if not k.startswith(unknown)})
        return cls(loaded.trace.name, loaded.trace, metrics, folder, missing)


def _stated(file: Path) -> Metrics:
    """The metrics that a run's folder states; ReportError for a file that holds none."""
    try:
        metrics = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ReportError(f"{file}: cannot be read ({error.strerror})") from None
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
    return Metrics(metrics)


def check_folders(folders: Sequence[Path | str]) -> None:
    """Raise ReportError, naming it, for a folder that is no run's, and for more folders than a report holds."""
    if not 1 <= len(folders) <= MAX_RUNS:
        raise ReportError(f"runs: found {len(folders)}, allowed: 1 to {MAX_RUNS}")
    for folder in map(Path, folders):
        if not (folder / "config.toml").is_file():
            found = "no config.toml in it" if folder.is_dir() else "no such folder"
            raise ReportError(f"{folder}: found {found}, allowed: the folder of a run")


def numbered_names(runs: Sequence[MeasuredRun]) -> list[str]:
    """The runs' names, numbered where several share one."""
    names = [run.name for run in runs]
    return [f"{name} ({k + 1})" if names.count(name) > 1 else name for k, name in enumerate(names)]
