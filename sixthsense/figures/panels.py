"""Complete figures of one or several runs, for reports and notebooks."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from sixthsense.evaluation.curves import Over
from sixthsense.evaluation.groups import Group, differences, fields_of
from sixthsense.evaluation.measured_run import MAX_RUNS, MeasuredRun, ReportError, numbered_names
from sixthsense.evaluation.results import Metrics, metrics_table
from sixthsense.evaluation.samples import sample_of
from sixthsense.figures import groups
from sixthsense.figures.canvas import WIDTH_IN, Canvas, FigureError, check_over
from sixthsense.figures.navigation import draw_exploration
from sixthsense.figures.overtime import COMPONENTS, draw_coverage, draw_error, draw_nees, draw_nis, draw_stages
from sixthsense.figures.picture import Picture
from sixthsense.figures.plot import CYCLE, draw_map, map_figure, map_height
from sixthsense.record.load import RecordPart
from sixthsense.record.trace import Trace

_TITLES = {
    "map": "Maps",
    "rpe": "Relative pose error by length of path",
    "error": "Pose error at keyframes, with the three-sigma bounds of the estimator",
    "nees": "Consistency of the pose: normalised estimation error squared",
    "nis": "Consistency of the matches: normalised innovation squared",
    "stages": "Computing time per stage",
    "coverage": "Area seen",
    "exploration": "Seen area, remaining frontiers, and plans over time",
}
_REQUIRED_DATA = {
    "error": "the truth at keyframes",
    "rpe": "the truth over at least a metre of path",
    "nees": "the truth at keyframes",
    "nis": "matched landmarks",
    "stages": "stage times",
    "coverage": "the truth and its scene",
    "exploration": "an exploration",
}
_REQUIRED_PARTS = {"exploration": RecordPart.GRID}
"""part of the record that a figure needs"""
_CARD_METRICS = (
    "outcome", "coverage", "ate_rmse_m", "heading_rmse_rad", "pose_nees_world_mean", "nis_mean_per_dof", "landmarks",
    "path_length_m", "sim_time_s", "wall_time_s",
)  # fmt: skip


def figure(what: str, runs: Sequence[MeasuredRun], over: Over = "time", ax: Any = None) -> Picture | None:
    """Draw the figure with this name for 1 to 12 runs; returns None where it is drawn on the caller's axes.

    Raises FigureError for a name that is not in `KINDS`, for a figure whose data all runs lack and for axes that do not
    do, and ReportError for another number of runs.
    """
    check_over(what, over, KINDS)
    canvas = Canvas(what, ax)
    if _drawn(canvas, runs, over):
        return canvas.picture
    part = _REQUIRED_PARTS.get(what)
    if part is not None and any(part.value in run.missing for run in runs):
        raise FigureError(f"{what}: found a folder without {part.value}, allowed: ss.replay, which estimates it again")
    raise FigureError(f"{what}: found a run without {_REQUIRED_DATA[what]}, allowed: a run that has it")


def figure_if_any(what: str, runs: Sequence[MeasuredRun]) -> Picture | None:
    """Draw the figure with a name in `KINDS`; None if all runs lack its data."""
    canvas = Canvas(what)
    return canvas.picture if _drawn(canvas, runs, "time") else None


def _drawn(canvas: Canvas, runs: Sequence[MeasuredRun], over: Over) -> bool:
    """Draw a figure with its title; returns False if all runs lack its data."""
    if not 1 <= len(runs) <= MAX_RUNS:
        raise ReportError(f"runs: found {len(runs)}, allowed: 1 to {MAX_RUNS}")
    names = numbered_names(runs)
    if not _DRAW_BY_KIND[canvas.what](runs, names, canvas, over):
        return False
    if len(runs) > 1:
        fields = [fields_of(name, run.trace.config) for name, run in zip(names, runs, strict=True)]
        canvas.entitle(_TITLES[canvas.what], differences(fields))
    elif canvas.what not in ("map", "exploration") or canvas.given is not None:
        canvas.entitle(runs[0].title)
    return True


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


def _maps(runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, _: Over) -> bool:
    if len(runs) == 1 and canvas.given is None:
        canvas.picture = map_figure(runs[0].trace, runs[0].title)
    else:
        _panel_per_run(runs, names, canvas, draw_map)
    return True


def _exploration(runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, _: Over) -> bool:
    traces = [run.trace for run in runs]
    shown = [k for k, t in enumerate(traces) if t.config.task == "explore" and t.plans and t.grid is not None]
    if shown:
        _panel_per_run([runs[k] for k in shown], [names[k] for k in shown], canvas, draw_exploration)
    return bool(shown)


def _panel_per_run(
    runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, draw: Callable[[Any, Trace], None]
) -> None:
    """One panel per run, drawn by `draw`, with a common legend."""
    columns = len(runs) if canvas.given is not None else min(len(runs), 3)
    rows = -(-len(runs) // columns)
    width = max(WIDTH_IN, 5.0 * columns)
    panels = canvas.panels(rows, columns, width, width)
    for ax, run, name in zip(panels, runs, names, strict=False):
        draw(ax, run.trace)
        if len(runs) > 1:
            ax.set_title(f"{name}: {run.outcome}", fontsize=10)
        elif canvas.given is None:
            ax.set_title(run.title)  # a title of the axes, not of the figure: equal scales leave a gap between the two
    if canvas.picture is None:
        return
    for ax in panels[len(runs) :]:
        ax.set_axis_off()
    heights = [map_height(ax, width / columns) for ax in panels[: len(runs)]]
    canvas.picture.set_size_inches(width, rows * max(heights) + (0.6 if len(runs) > 1 else 0.0))
    canvas.label_below(panels)


def _errors(runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, over: Over) -> bool:
    """Errors of x, y and heading with their bounds, a column per run; on a single Axes the position's magnitude."""
    shown = _with_truth(runs)
    if not shown:
        return False
    if canvas.is_one:
        return groups.errors(_a_group_each(runs, names), canvas, over)
    width = max(WIDTH_IN, 4.0 * len(shown))
    axes = canvas.panels(len(COMPONENTS), len(shown), width, 8.0, sharex="col", sharey="row")
    panels = np.array(axes).reshape(len(COMPONENTS), len(shown))
    for column, k in enumerate(shown):
        for component, ax in enumerate(panels[:, column]):
            draw_error(ax, runs[k].trace, component, _run_color(k), over)
            if canvas.given is None:
                ax.label_outer()
        if len(runs) > 1:
            panels[0, column].legend(loc="upper left", ncols=2, frameon=False)
            panels[0, column].set_title(names[k], fontsize=10)
        else:
            canvas.label(panels[0, column])
    return True


def _nees(runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, over: Over) -> bool:
    """In world and in right-invariant coordinates; on a single Axes the former."""
    shown = _with_truth(runs)
    if not shown:
        return False
    panels = canvas.panels(1 if canvas.is_one else 2, 1, WIDTH_IN, 8.0, sharex=True, sharey=True)
    frames: tuple[Literal["world", "invariant"], ...] = ("world", "invariant")
    for ax, frame in zip(panels, frames, strict=False):
        for k in shown:
            label = names[k] if len(runs) > 1 else None
            draw_nees(ax, runs[k].trace, frame, _run_color(k), label, k == shown[0], over)
        canvas.label(ax)
    if canvas.given is None:
        panels[0].set_xlabel("")
    return True


def _nis(runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, _: Over) -> bool:
    shown = [k for k, run in enumerate(runs) if any(association.dof for association in run.trace.associations)]
    if not shown:
        return False
    panels = canvas.panels(len(shown), 1, WIDTH_IN, 2.0 + 2.4 * len(shown), sharex=True, sharey=True)
    # One panel per run: the band depends on the number of matched landmarks.
    for ax, k in zip(panels, shown, strict=True):
        draw_nis(ax, runs[k].trace, _run_color(k), names[k] if len(runs) > 1 else None)
        canvas.label(ax)
        if canvas.given is None:
            ax.label_outer()
    return True


def _stages(runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, _: Over) -> bool:
    shown = [k for k, run in enumerate(runs) if any(key.startswith("stage_ms_mean.") for key in run.metrics)]
    if not shown:
        return False
    (ax,) = canvas.panels(1, 1, WIDTH_IN, 4.0 + 0.9 * len(shown))
    draw_stages(ax, [runs[k].metrics for k in shown], [names[k] for k in shown] if len(runs) > 1 else None)
    canvas.label(ax)
    return True


def _coverage(runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, _: Over) -> bool:
    shown = [k for k in _with_truth(runs) if runs[k].trace.scene is not None]
    if not shown:
        return False
    (ax,) = canvas.panels(1, 1, WIDTH_IN, 5.0)
    for k in shown:
        draw_coverage(ax, runs[k].trace, _run_color(k), names[k] if len(runs) > 1 else None)
    canvas.label(ax)
    return True


def _relative_errors(runs: Sequence[MeasuredRun], names: Sequence[str], canvas: Canvas, _: Over) -> bool:
    return groups.relative_errors(_a_group_each(runs, names), canvas)


def _a_group_each(runs: Sequence[MeasuredRun], names: Sequence[str]) -> list[Group]:
    labels = names if len(runs) > 1 else [""]
    return [Group(label, (sample_of(label, run),)) for label, run in zip(labels, runs, strict=True)]


_DRAW_BY_KIND: dict[str, Callable[[Sequence[MeasuredRun], Sequence[str], Canvas, Over], bool]] = {
    "map": _maps,
    "error": _errors,
    "rpe": _relative_errors,
    "nees": _nees,
    "nis": _nis,
    "stages": _stages,
    "coverage": _coverage,
    "exploration": _exploration,
}

KINDS = tuple(_DRAW_BY_KIND)
"""names of the figures"""
