"""A report on runs that are over: the figures of one, or of several side by side, and a table of their metrics."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sixthsense.config.section import shown, shown_name
from sixthsense.errors import InputError
from sixthsense.figures import COMPONENTS, draw_coverage, draw_error, draw_exploration, draw_nees, draw_nis, draw_stages
from sixthsense.plot import CYCLE, draw_map, map_height, new_figure, save, save_map
from sixthsense.trace import Trace

_WIDTH_IN = 11.0
_TITLES = {
    "error": "Pose error at key scans, within three sigma as the estimator promises",
    "nees": "Consistency of the pose: normalised estimation error squared",
    "nis": "Consistency of the matches: normalised innovation squared",
    "stages": "Where the time goes",
    "coverage": "Area seen",
    "exploration": "Seen area, what is left of its frontiers, and the plans over time",
}
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
    metrics: Mapping[str, Any]
    """as the run measured them; of a run that was killed, what can still be measured"""

    @property
    def title(self) -> str:
        """What the run was, and how it ended."""
        config, outcome = self.trace.config, self.metrics.get("outcome", self.trace.outcome)
        of = f"{config.scene} · " if self.trace.scene is not None and not Path(config.scene).suffix else ""
        return f"{self.name}: {of}{config.estimator} · {config.preset} · seed {config.seed} · {outcome}"


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
        measured = {key: value for key, value in trace.metrics().items() if not key.startswith(timed)}
        return FinishedRun(_name(folder), trace, measured)
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
    return FinishedRun(_name(folder), trace, metrics)


def _name(folder: Path) -> str:
    return folder.resolve().name.removesuffix(".partial")


def report(runs: Sequence[FinishedRun], out: Path | str) -> list[Path]:
    """Write the figures of one run, or of several side by side with `metrics.csv`, into `out`, made if missing.

    Returns the files written. A figure that no run can fill (errors without truth) is left out. Raises ReportError for
    more than 12 runs, or none.
    """
    if not 1 <= len(runs) <= MOST_RUNS:
        raise ReportError(f"runs: found {len(runs)}, allowed: 1 to {MOST_RUNS}")
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    names = _distinct(runs)
    makers: dict[str, Callable[[Sequence[FinishedRun], Sequence[str]], Any]] = {
        "error": _errors,
        "nees": _nees,
        "nis": _nis,
        "stages": _stages,
        "coverage": _coverage,
        "exploration": _exploration,
    }
    files = [out / "map.png"]
    if len(runs) == 1:
        save_map(runs[0].trace, files[0], runs[0].title)
    else:
        save(_maps(runs, names), files[0])
    for kind, make in makers.items():
        figure = make(runs, names)
        if figure is not None:
            if len(runs) > 1:
                figure.suptitle(_TITLES[kind])
            elif kind != "exploration":
                figure.suptitle(runs[0].title)
            files.append(out / f"{kind}.png")
            save(figure, files[-1])
    if len(runs) > 1:
        files.append(out / "metrics.csv")
        with files[-1].open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(table(runs))
    return files


def table(runs: Sequence[FinishedRun]) -> list[list[str]]:
    """A head and one row per metric, one column per run, all digits; empty where a run has not measured it."""
    keys = list(dict.fromkeys(key for run in runs for key in run.metrics))
    rows = [[key, *(str(run.metrics.get(key, "")) for run in runs)] for key in keys]
    return [["metric", *_distinct(runs)], *rows]


def compact(rows: Sequence[Sequence[str]]) -> str:
    """A table's rows as lines with columns, numbers to four digits."""
    short = [[row[0], *map(_four_digits, row[1:])] for row in rows]
    widths = [max(map(len, column)) for column in zip(*short, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in short
    )


def _four_digits(cell: str) -> str:
    try:
        return cell if cell.lstrip("-").isdigit() else f"{float(cell):.4g}"
    except ValueError:
        return cell


def _distinct(runs: Sequence[FinishedRun]) -> list[str]:
    """The runs' names, numbered where two folders share one."""
    names = [run.name for run in runs]
    return [f"{name} ({k + 1})" if names.count(name) > 1 else name for k, name in enumerate(names)]


def _with_truth(runs: Sequence[FinishedRun]) -> list[int]:
    return [k for k, run in enumerate(runs) if run.trace.key_truths]


def _color(k: int) -> str:
    return CYCLE[k % len(CYCLE)]


def _maps(runs: Sequence[FinishedRun], names: Sequence[str]) -> Any:
    return _planes(runs, names, draw_map)


def _exploration(runs: Sequence[FinishedRun], names: Sequence[str]) -> Any:
    shown = [k for k, run in enumerate(runs) if run.trace.config.task == "explore" and run.trace.plans]
    if not shown:
        return None
    return _planes([runs[k] for k in shown], [names[k] for k in shown], draw_exploration)


def _planes(runs: Sequence[FinishedRun], names: Sequence[str], draw: Callable[[Any, Trace], None]) -> Any:
    """One panel a run, drawn by `draw`, with one legend."""
    columns = min(len(runs), 3)
    rows = -(-len(runs) // columns)
    width = max(_WIDTH_IN, 5.0 * columns)
    figure = new_figure(width, width)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, run, name in zip(panels, runs, names, strict=False):
        draw(ax, run.trace)
        if len(runs) > 1:
            ax.set_title(f"{name}: {run.metrics.get('outcome', run.trace.outcome)}", fontsize=10)
        else:
            ax.set_title(run.title)  # of the plane, not of the figure: equal axes leave room between the two
    for ax in panels[len(runs) :]:
        ax.set_axis_off()
    heights = [map_height(ax, width / columns) for ax in panels[: len(runs)]]
    figure.set_size_inches(width, rows * max(heights) + (0.6 if len(runs) > 1 else 0.0))
    entries = {label: handle for ax in panels for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=5, frameon=False)
    return figure


def _errors(runs: Sequence[FinishedRun], names: Sequence[str]) -> Any:
    shown = _with_truth(runs)
    if not shown:
        return None
    figure = new_figure(max(_WIDTH_IN, 4.0 * len(shown)), 8.0)
    panels = figure.subplots(len(COMPONENTS), len(shown), sharex="col", sharey="row", squeeze=False)
    for column, k in enumerate(shown):
        for component, ax in enumerate(panels[:, column]):
            draw_error(ax, runs[k].trace, component, _color(k))
            ax.label_outer()
        if len(runs) > 1:
            panels[0, column].legend(loc="upper left", ncols=2, frameon=False)
            panels[0, column].set_title(names[k], fontsize=10)
        else:
            _legend_above(panels[0, column])
    return figure


def _nees(runs: Sequence[FinishedRun], names: Sequence[str]) -> Any:
    shown = _with_truth(runs)
    if not shown:
        return None
    figure = new_figure(_WIDTH_IN, 8.0)
    upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
    for k in shown:
        label = names[k] if len(runs) > 1 else None
        draw_nees(upper, runs[k].trace, "world", _color(k), label, band=k == shown[0])
        draw_nees(lower, runs[k].trace, "invariant", _color(k), label, band=k == shown[0])
    for ax in (upper, lower):
        _legend_above(ax)
    upper.set_xlabel("")
    return figure


def _nis(runs: Sequence[FinishedRun], names: Sequence[str]) -> Any:
    shown = [k for k, run in enumerate(runs) if any(association.dof for association in run.trace.associations)]
    if not shown:
        return None
    figure = new_figure(_WIDTH_IN, 2.0 + 2.4 * len(shown))
    panels = figure.subplots(len(shown), 1, sharex=True, sharey=True, squeeze=False).ravel()
    # One panel a run: each has a band of its own, by the landmarks it matched.
    for ax, k in zip(panels, shown, strict=True):
        draw_nis(ax, runs[k].trace, _color(k), names[k] if len(runs) > 1 else None)
        _legend_above(ax)
        ax.label_outer()
    return figure


def _stages(runs: Sequence[FinishedRun], names: Sequence[str]) -> Any:
    shown = [k for k, run in enumerate(runs) if any(key.startswith("stage_ms_mean.") for key in run.metrics)]
    if not shown:
        return None
    figure = new_figure(_WIDTH_IN, 4.0 + 0.9 * len(shown))
    ax = figure.add_subplot()
    draw_stages(ax, [runs[k].metrics for k in shown], [names[k] for k in shown] if len(runs) > 1 else None)
    if ax.get_legend_handles_labels()[1]:
        _legend_above(ax)
    return figure


def _coverage(runs: Sequence[FinishedRun], names: Sequence[str]) -> Any:
    shown = [k for k in _with_truth(runs) if runs[k].trace.scene is not None]
    if not shown:
        return None
    figure = new_figure(_WIDTH_IN, 5.0)
    ax = figure.add_subplot()
    for k in shown:
        draw_coverage(ax, runs[k].trace, _color(k), names[k] if len(runs) > 1 else None)
    _legend_above(ax)
    return figure


def _legend_above(ax: Any) -> None:
    """A legend that hides nothing, in as many columns as its words leave room for."""
    longest = max(map(len, ax.get_legend_handles_labels()[1]), default=0)
    columns = max(1, min(3, 120 // (longest + 8)))
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, borderaxespad=0.2)
