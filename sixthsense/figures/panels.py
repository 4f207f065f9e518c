"""The figures of runs, side by side or in groups: one table has them all."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.core.picture import Picture
from sixthsense.evaluation.curves import Over
from sixthsense.evaluation.groups import Group, Sample, differences, fields_of, grouped
from sixthsense.evaluation.measured_run import MAX_RUNS, MeasuredRun, numbered_names
from sixthsense.evaluation.results import Metrics, metrics_table
from sixthsense.figures import groups
from sixthsense.figures.canvas import WIDTH_IN, Canvas
from sixthsense.figures.navigation import draw_exploration
from sixthsense.figures.overtime import COMPONENTS, draw_coverage, draw_error, draw_nees, draw_nis, draw_stages
from sixthsense.figures.plot import CYCLE, draw_map, map_figure, map_height
from sixthsense.record.store import RecordPart
from sixthsense.record.trace import Trace

_CARD_METRICS = (
    "outcome", "coverage", "ate_rmse_m", "heading_rmse_rad", "pose_nees_world_mean", "nis_mean_per_dof", "landmarks",
    "path_length_m", "sim_time_s", "wall_time_s",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Shown:
    """A run in a figure of one or several."""

    run: MeasuredRun
    label: str | None
    """its name among several runs"""
    color: str

    @property
    def trace(self) -> Trace:
        return self.run.trace

    @property
    def group(self) -> Group:
        """The run as a group of its own."""
        name = self.label or ""
        return Group(name, (self.run.sample(name),))


class OfGroups(NamedTuple):
    """How a figure shows groups of runs."""

    title: str
    """with the place of the axis that it is drawn over"""
    spread: str
    """of the title, where a group has several runs"""
    draw: Callable[[Sequence[Group], Canvas], None]
    """draws the groups that have its data, at least one"""
    has: Callable[[Group], object]
    """whether a group has its data"""


@dataclass(frozen=True, slots=True)
class Kind:
    """A figure of one or several runs."""

    title: str
    """over the figure of several runs"""
    caption: str
    """below it on the page of a report"""
    draw: Callable[[Sequence[_Shown], Canvas], None]
    """draws the runs that have its data, at least one"""
    has: Callable[[_Shown], object] = lambda _: True
    """whether a run has its data"""
    data: str = ""
    """what it shows, in words"""
    part: RecordPart | None = None
    """of the record that it needs"""
    groups: OfGroups | None = None
    """the same of groups of runs, if it is drawn of them"""


def figure(what: str, runs: Sequence[MeasuredRun], over: Over = "time", ax: Any = None) -> Picture | None:
    """Draw the figure with this name for 1 to 12 runs; returns None where it is drawn on the caller's axes.

    Raises InputError for a name that is not in `KINDS`, for a figure whose data all runs lack and for axes that do not
    do, and InputError for another number of runs.
    """
    canvas = Canvas(what, list(KINDS), over, ax)
    if _drawn(canvas, runs):
        return canvas.picture
    part = KINDS[what].part
    if part is not None and any(part.value in run.missing for run in runs):
        raise InputError(what, f"found a folder without {part.value}", "ss.replay, which estimates it again")
    raise InputError(what, f"found a run without {KINDS[what].data}", "a run that has it")


def figure_if_any(what: str, runs: Sequence[MeasuredRun]) -> Picture | None:
    """Draw the figure with a name in `KINDS`; None if all runs lack its data."""
    canvas = Canvas(what, list(KINDS))
    return canvas.picture if _drawn(canvas, runs) else None


def group_figure(what: str, samples: Sequence[Sample], by: str | Sequence[str], over: Over, ax: Any) -> Picture | None:
    """Draw a figure of the runs in groups by these fields; returns None where it is drawn on the caller's axes.

    Raises InputError for a name that is none of these, for runs that lack the figure's data, and for a field that there
    is not.
    """
    kinds = {name: kind.groups for name, kind in KINDS.items() if kind.groups is not None}
    canvas = Canvas(what, list(kinds), over, ax)
    found, kind = grouped(samples, by), kinds[what]
    known = [group for group in found if kind.has(group)]
    if not known:
        kept = "runs with truth, campaigns of this version"
        raise InputError(what, "found no run whose errors are known", kept)
    kind.draw(known, canvas)
    title = kind.title.format(over="time" if over == "time" else "distance travelled")
    spread = kind.spread if len(found) < len(samples) else ""
    canvas.entitle(title + spread, differences([sample.fields for sample in samples]))
    return canvas.picture


def _drawn(canvas: Canvas, runs: Sequence[MeasuredRun]) -> bool:
    """Draw a figure with its title; returns False if all runs lack its data."""
    if not 1 <= len(runs) <= MAX_RUNS:
        raise InputError("runs", f"found {len(runs)}", f"1 to {MAX_RUNS}")
    names, kind, several = numbered_names(runs), KINDS[canvas.what], len(runs) > 1
    shown = [_Shown(run, names[k] if several else None, CYCLE[k % len(CYCLE)]) for k, run in enumerate(runs)]
    shown = [one for one in shown if kind.has(one)]
    if not shown:
        return False
    kind.draw(shown, canvas)
    if several:
        fields = [fields_of(name, run.trace.config) for name, run in zip(names, runs, strict=True)]
        canvas.entitle(kind.title, differences(fields))
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


def _maps(shown: Sequence[_Shown], canvas: Canvas) -> None:
    if shown[0].label is None and canvas.picture is not None:
        map_figure(shown[0].trace, shown[0].run.title, figure=canvas.picture)
    else:
        _panel_per_run(shown, canvas, draw_map)


def _explorations(shown: Sequence[_Shown], canvas: Canvas) -> None:
    _panel_per_run(shown, canvas, draw_exploration)


def _panel_per_run(shown: Sequence[_Shown], canvas: Canvas, draw: Callable[[Any, Trace], None]) -> None:
    """One panel per run, drawn by `draw`, with a common legend."""
    columns = len(shown) if canvas.given is not None else min(len(shown), 3)
    rows = -(-len(shown) // columns)
    width = max(WIDTH_IN, 5.0 * columns)
    panels = canvas.panels(rows, columns, width, width)
    for ax, one in zip(panels, shown, strict=False):
        draw(ax, one.trace)
        if len(shown) > 1:
            ax.set_title(f"{one.label}: {one.run.outcome}", fontsize=10)
        elif canvas.given is None:
            ax.set_title(one.run.title)  # of the axes, not of the figure: equal scales leave a gap between the two
    if canvas.picture is None:
        return
    for ax in panels[len(shown) :]:
        ax.set_axis_off()
    heights = [map_height(ax, width / columns) for ax in panels[: len(shown)]]
    canvas.picture.set_size_inches(width, rows * max(heights) + (0.6 if len(shown) > 1 else 0.0))
    canvas.label_below(panels)


def _errors(shown: Sequence[_Shown], canvas: Canvas) -> None:
    """Errors of x, y and heading with their bounds, a column per run; on a single Axes the position's magnitude."""
    if canvas.is_one:
        groups.draw_errors([one.group for one in shown], canvas)
        return
    width = max(WIDTH_IN, 4.0 * len(shown))
    axes = canvas.panels(len(COMPONENTS), len(shown), width, 8.0, sharex="col", sharey="row")
    for one, column in zip(shown, np.array(axes).reshape(len(COMPONENTS), len(shown)).T, strict=True):
        for component, ax in enumerate(column):
            draw_error(ax, one.trace, component, one.color, canvas.over)
            if canvas.given is None:
                ax.label_outer()
        if one.label is None:
            canvas.label(column[0])
        else:
            column[0].legend(loc="upper left", ncols=2, frameon=False)
            column[0].set_title(one.label, fontsize=10)


def _nees(shown: Sequence[_Shown], canvas: Canvas) -> None:
    (ax,) = canvas.panels(1, 1, WIDTH_IN, 4.4)
    for k, one in enumerate(shown):
        draw_nees(ax, one.trace, one.color, one.label, k == 0, canvas.over)
    canvas.label(ax)


def _nis(shown: Sequence[_Shown], canvas: Canvas) -> None:
    """One panel per run: the band depends on the number of matched landmarks."""
    panels = canvas.panels(len(shown), 1, WIDTH_IN, 2.0 + 2.4 * len(shown), sharex=True, sharey=True)
    for ax, one in zip(panels, shown, strict=True):
        draw_nis(ax, one.trace, one.color, one.label)
        canvas.label(ax)
        if canvas.given is None:
            ax.label_outer()


def _stages(shown: Sequence[_Shown], canvas: Canvas) -> None:
    (ax,) = canvas.panels(1, 1, WIDTH_IN, 4.0 + 0.9 * len(shown))
    draw_stages(ax, [one.run.metrics for one in shown], [one.label for one in shown])
    canvas.label(ax)


def _coverage(shown: Sequence[_Shown], canvas: Canvas) -> None:
    (ax,) = canvas.panels(1, 1, WIDTH_IN, 5.0)
    for one in shown:
        draw_coverage(ax, one.trace, one.color, one.label)
    canvas.label(ax)


def _relative_errors(shown: Sequence[_Shown], canvas: Canvas) -> None:
    groups.draw_relative([one.group for one in shown], canvas)


_MEDIAN = ": median of the runs, and 10 to 90 % of them"
KINDS = {
    "map": Kind(
        "Maps", "Map: true walls, detected walls, landmarks with 95 % ellipses, planned and driven paths.", _maps
    ),
    "error": Kind(
        "Pose error at every scan, and at keyframes with the three-sigma bounds of the estimator",
        "Error of the pose at every scan, and at keyframes with the three-sigma bounds that the estimator has there.",
        _errors, lambda one: one.trace.key_truths, "the truth at keyframes",
        groups=OfGroups("Pose error over {over}", _MEDIAN, groups.draw_errors, Group.curves),
    ),
    "rpe": Kind(
        "Relative pose error by length of path",
        "Relative pose error: that of the motion over every piece of path of a length, root mean square.",
        _relative_errors, lambda one: groups.has_relative(one.group), "the truth over at least a metre of path",
        groups=OfGroups("Relative pose error by length of path", _MEDIAN, groups.draw_relative, groups.has_relative),
    ),
    "nees": Kind(
        "Consistency of the pose: normalised estimation error squared",
        "Consistency of the pose: normalised estimation error squared (NEES), 3 on average if consistent.",
        _nees, lambda one: one.trace.key_truths, "the truth at keyframes",
        groups=OfGroups("Pose NEES over {over}", ", averaged over the runs", groups.draw_consistency, groups.has_nees),
    ),
    "nis": Kind(
        "Consistency of the matches: normalised innovation squared",
        "Consistency of the matches: normalised innovation squared (NIS) per dof, 1 on average if consistent.",
        _nis, lambda one: any(found.dof for found in one.trace.associations), "matched landmarks",
    ),
    "stages": Kind(
        "Computing time per stage", "Computing time of the stages of a keyframe.",
        _stages, lambda one: any(key.startswith("stage_ms_mean.") for key in one.run.metrics), "stage times",
    ),
    "coverage": Kind(
        "Area seen", "Seen share of the visible area, over time.",
        _coverage, lambda one: one.trace.key_truths and one.trace.scene, "the truth and its scene",
    ),
    "exploration": Kind(
        "Seen area, remaining frontiers, and plans over time",
        "Exploration: seen area, remaining frontiers, and planned paths, pale to dark over time.",
        _explorations, lambda one: one.trace.config.task == "explore" and one.trace.plans and one.trace.grid,
        "an exploration", RecordPart.GRID,
    ),
}  # fmt: skip
"""the figures by their names"""
