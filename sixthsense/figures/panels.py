"""Complete figures of one or several runs, for reports and notebooks."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Sequence
from typing import Any

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.evaluation.measured_run import MAX_RUNS, MeasuredRun, ReportError, numbered_names
from sixthsense.evaluation.results import Metrics, metrics_table
from sixthsense.figures.navigation import draw_exploration
from sixthsense.figures.overtime import COMPONENTS, draw_coverage, draw_error, draw_nees, draw_nis, draw_stages
from sixthsense.figures.picture import Picture
from sixthsense.figures.plot import CYCLE, draw_map, map_figure, map_height, new_figure
from sixthsense.record.load import RecordPart
from sixthsense.record.trace import Trace

_WIDTH_IN = 11.0
_TITLES = {
    "error": "Pose error at keyframes, with the three-sigma bounds of the estimator",
    "nees": "Consistency of the pose: normalised estimation error squared",
    "nis": "Consistency of the matches: normalised innovation squared",
    "stages": "Computing time per stage",
    "coverage": "Area seen",
    "exploration": "Seen area, remaining frontiers, and plans over time",
}
_REQUIRED_DATA = {
    "error": "the truth at keyframes",
    "nees": "the truth at keyframes",
    "nis": "matched landmarks",
    "stages": "stage times",
    "coverage": "the truth and its scene",
    "exploration": "an exploration",
}
_REQUIRED_PARTS = {"nis": RecordPart.KEYFRAMES, "stages": RecordPart.KEYFRAMES, "exploration": RecordPart.GRID}
"""part of the record that a figure needs"""
_CARD_METRICS = (
    "outcome", "coverage", "ate_rmse_m", "heading_rmse_rad", "pose_nees_world_mean", "nis_mean_per_dof", "landmarks",
    "path_length_m", "sim_time_s", "wall_time_s",
)  # fmt: skip


class FigureError(InputError):
    """A figure that cannot be drawn: one line with its name, what was found and what is allowed."""


def figure(what: str, runs: Sequence[MeasuredRun]) -> Picture:
    """Draw the figure with this name for 1 to 12 runs.

    Raises FigureError for a name that is not in `KINDS` and for a figure whose data all runs lack, and ReportError for
    another number of runs.
    """
    if what not in KINDS:
        raise FigureError(f"what: found {shown(what)}, {allowed_names(KINDS, nearest(what, KINDS))}")
    drawn = figure_if_any(what, runs)
    if drawn is not None:
        return drawn
    part = _REQUIRED_PARTS.get(what)
    if part is not None and any(part.value in run.missing for run in runs):
        raise FigureError(f"{what}: found a folder without {part.value}, allowed: ss.replay, which estimates it again")
    raise FigureError(f"{what}: found a run without {_REQUIRED_DATA[what]}, allowed: a run that has it")


def figure_if_any(what: str, runs: Sequence[MeasuredRun]) -> Picture | None:
    """Draw the figure with a name in `KINDS`; None if all runs lack its data."""
    if not 1 <= len(runs) <= MAX_RUNS:
        raise ReportError(f"runs: found {len(runs)}, allowed: 1 to {MAX_RUNS}")
    if what == "map" and len(runs) == 1:
        return map_figure(runs[0].trace, runs[0].title)
    drawn = _DRAW_BY_KIND[what](runs, numbered_names(runs))
    if drawn is not None and what != "map":
        if len(runs) > 1:
            drawn.suptitle(_TITLES[what])
        elif what != "exploration":
            drawn.suptitle(runs[0].title)
    return drawn


def card(run: MeasuredRun) -> str:
    """A run in HTML: its title, a small map, and the most important metrics."""
    picture = base64.b64encode(map_figure(run.trace, "", 5.0, legend=False).png(dpi=70.0)).decode()
    metrics = Metrics({key: run.metrics[key] for key in _CARD_METRICS if key in run.metrics})
    return (
        f"<div><b>{html.escape(run.title)}</b><br>"
        f'<img alt="map" src="data:image/png;base64,{picture}" style="display:inline-block;vertical-align:top">'
        f'<div style="display:inline-block;vertical-align:top;padding-left:1em">'
        f"{metrics_table(['metric', 'value'], [metrics])}</div></div>"
    )


def _with_truth(runs: Sequence[MeasuredRun]) -> list[int]:
    return [k for k, run in enumerate(runs) if run.trace.key_truths]


def _run_color(k: int) -> str:
    return CYCLE[k % len(CYCLE)]


def _maps(runs: Sequence[MeasuredRun], names: Sequence[str]) -> Picture:
    return _panel_per_run(runs, names, draw_map)


def _exploration(runs: Sequence[MeasuredRun], names: Sequence[str]) -> Picture | None:
    traces = [run.trace for run in runs]
    shown = [k for k, t in enumerate(traces) if t.config.task == "explore" and t.plans and t.grid is not None]
    if not shown:
        return None
    return _panel_per_run([runs[k] for k in shown], [names[k] for k in shown], draw_exploration)


def _panel_per_run(runs: Sequence[MeasuredRun], names: Sequence[str], draw: Callable[[Any, Trace], None]) -> Picture:
    """One panel per run, drawn by `draw`, with a common legend."""
    columns = min(len(runs), 3)
    rows = -(-len(runs) // columns)
    width = max(_WIDTH_IN, 5.0 * columns)
    figure = new_figure(width, width)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, run, name in zip(panels, runs, names, strict=False):
        draw(ax, run.trace)
        if len(runs) > 1:
            ax.set_title(f"{name}: {run.outcome}", fontsize=10)
        else:
            ax.set_title(run.title)  # a title of the axes, not of the figure: equal scales leave a gap between the two
    for ax in panels[len(runs) :]:
        ax.set_axis_off()
    heights = [map_height(ax, width / columns) for ax in panels[: len(runs)]]
    figure.set_size_inches(width, rows * max(heights) + (0.6 if len(runs) > 1 else 0.0))
    entries = {label: handle for ax in panels for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=5, frameon=False)
    return figure


def _errors(runs: Sequence[MeasuredRun], names: Sequence[str]) -> Picture | None:
    shown = _with_truth(runs)
    if not shown:
        return None
    figure = new_figure(max(_WIDTH_IN, 4.0 * len(shown)), 8.0)
    panels = figure.subplots(len(COMPONENTS), len(shown), sharex="col", sharey="row", squeeze=False)
    for column, k in enumerate(shown):
        for component, ax in enumerate(panels[:, column]):
            draw_error(ax, runs[k].trace, component, _run_color(k))
            ax.label_outer()
        if len(runs) > 1:
            panels[0, column].legend(loc="upper left", ncols=2, frameon=False)
            panels[0, column].set_title(names[k], fontsize=10)
        else:
            _legend_above(panels[0, column])
    return figure


def _nees(runs: Sequence[MeasuredRun], names: Sequence[str]) -> Picture | None:
    shown = _with_truth(runs)
    if not shown:
        return None
    figure = new_figure(_WIDTH_IN, 8.0)
    upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
    for k in shown:
        label = names[k] if len(runs) > 1 else None
        draw_nees(upper, runs[k].trace, "world", _run_color(k), label, band=k == shown[0])
        draw_nees(lower, runs[k].trace, "invariant", _run_color(k), label, band=k == shown[0])
    for ax in (upper, lower):
        _legend_above(ax)
    upper.set_xlabel("")
    return figure


def _nis(runs: Sequence[MeasuredRun], names: Sequence[str]) -> Picture | None:
    shown = [k for k, run in enumerate(runs) if any(association.dof for association in run.trace.associations)]
    if not shown:
        return None
    figure = new_figure(_WIDTH_IN, 2.0 + 2.4 * len(shown))
    panels = figure.subplots(len(shown), 1, sharex=True, sharey=True, squeeze=False).ravel()
    # One panel per run: the band depends on the number of matched landmarks.
    for ax, k in zip(panels, shown, strict=True):
        draw_nis(ax, runs[k].trace, _run_color(k), names[k] if len(runs) > 1 else None)
        _legend_above(ax)
        ax.label_outer()
    return figure


def _stages(runs: Sequence[MeasuredRun], names: Sequence[str]) -> Picture | None:
    shown = [k for k, run in enumerate(runs) if any(key.startswith("stage_ms_mean.") for key in run.metrics)]
    if not shown:
        return None
    figure = new_figure(_WIDTH_IN, 4.0 + 0.9 * len(shown))
    ax = figure.add_subplot()
    draw_stages(ax, [runs[k].metrics for k in shown], [names[k] for k in shown] if len(runs) > 1 else None)
    if ax.get_legend_handles_labels()[1]:
        _legend_above(ax)
    return figure


def _coverage(runs: Sequence[MeasuredRun], names: Sequence[str]) -> Picture | None:
    shown = [k for k in _with_truth(runs) if runs[k].trace.scene is not None]
    if not shown:
        return None
    figure = new_figure(_WIDTH_IN, 5.0)
    ax = figure.add_subplot()
    for k in shown:
        draw_coverage(ax, runs[k].trace, _run_color(k), names[k] if len(runs) > 1 else None)
    _legend_above(ax)
    return figure


def _legend_above(ax: Any) -> None:
    """Place the legend above the axes, with as many columns as fit."""
    longest = max(map(len, ax.get_legend_handles_labels()[1]), default=0)
    columns = max(1, min(3, 120 // (longest + 8)))
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, borderaxespad=0.2)


_DRAW_BY_KIND: dict[str, Callable[[Sequence[MeasuredRun], Sequence[str]], Picture | None]] = {
    "map": _maps,
    "error": _errors,
    "nees": _nees,
    "nis": _nis,
    "stages": _stages,
    "coverage": _coverage,
    "exploration": _exploration,
}

KINDS = tuple(_DRAW_BY_KIND)
"""names of the figures"""
