"""The figures of runs, one by one, side by side or in groups: one table has them all."""

from __future__ import annotations

import functools
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.section import shown
from sixthsense.evaluation.consistency import Consistency
from sixthsense.evaluation.curves import PLACE, Over
from sixthsense.evaluation.groups import Sample, differences, grouped, numbers, resampled
from sixthsense.evaluation.measured_run import MAX_RUNS
from sixthsense.evaluation.metrics import RPE_LENGTHS_M
from sixthsense.evaluation.summary import EFFECTIVE, pooled
from sixthsense.figures import overtime
from sixthsense.figures.canvas import columns_for, in_millimetres, legend, legend_above
from sixthsense.figures.plot import CYCLE, MAP_WIDTH_IN, draw_exploration, draw_map, map_height, new_figure

WIDTH_IN = 7.5
"""of most figures, which are legible at 500 pixels"""

_COLUMN_LETTERS = 44  # of a line of a legend that a column of a journal has room for
_ERRORS = (("position_m", "position error [m]", 1.0), ("heading_rad", "heading error [°]", float(np.degrees(1.0))))
_RELATIVE = (("trans_m", "relative translation error [m]"), ("rot_deg", "relative rotation error [°]"))
_QUANTILES = (0.1, 0.5, 0.9)
"""shares of the runs: limits of a band, and its median"""


@dataclass(frozen=True, slots=True)
class Curve:
    """What a figure shows in one colour: a run, or the runs of a group."""

    name: str
    """of the run among several, or of the group; empty of a single run"""
    samples: list[Sample]
    """at least one"""
    run: Any = None
    """with its record; None of a group, and of a run without a record"""

    @property
    def trace(self) -> Any:
        """The record of the only run; None without one."""
        return None if self.run is None else self.run.trace

    @property
    def label(self) -> str:
        """The name, with the number of several runs."""
        return f"{self.name}, {len(self.samples)} runs" if len(self.samples) > 1 else self.name

    def errors(self) -> list[Any]:
        """The frames of errors of the runs whose errors are known."""
        return [found for sample in self.samples if (found := sample.curves()) is not None]


@dataclass(frozen=True, slots=True)
class Kind:
    """A figure of runs."""

    title: str
    """over the figure of several runs"""
    caption: str
    """below it on a page"""
    draw: Callable[[Sequence[Curve], list[Any], Over], None]
    """draws the curves that have its data, at least one, on the panels"""
    has: Callable[[Curve], object]
    """whether a curve has its data"""
    data: str
    """what it shows, in words"""
    shape: Callable[[Sequence[Curve]], tuple[int, int, float]]
    """rows and columns of panels, and the height of a row, inches"""
    per_run: bool = False
    """whether each run has a panel"""


def plot(
    what: str, runs: Sequence[Sample], by: str | Sequence[str] | None = None, ax: Any = None, over: Over = "time"
) -> Any:
    """Draw the figure with this name of 1 to 12 runs, or of groups of runs by some fields.

    Returns a new picture; or `ax`, one Axes of matplotlib or several, on which it is drawn in place, without a title.
    Raises InputError for a name that is not in `KINDS`, for a figure whose data all runs lack, for another number of
    runs or axes, and for a field that there is not.
    """
    allowed = list(KINDS) if by is None else list(OF_GROUPS)
    if what not in allowed:
        raise InputError("what", f"found {shown(what)}", ", ".join(allowed), nearest(what, allowed))
    if over not in (places := ("time", "distance") if what in ("error", "nees") else ("time",)):
        raise InputError("over", f"found {shown(over)} for {what}", ", ".join(places))
    if by is None and not 1 <= len(runs) <= MAX_RUNS:
        raise InputError("runs", f"found {len(runs)}", f"1 to {MAX_RUNS}")
    if by is None:
        curves = [Curve(one.name if len(runs) > 1 else "", [one], one.run) for one in runs]
    else:
        curves = [Curve(name, samples) for name, samples in grouped(runs, by).items()]
    kind, known = KINDS[what], [curve for curve in curves if KINDS[what].has(curve)]
    if not known:
        raise InputError(what, f"found a run without {kind.data}", "a run that has it")
    rows, columns, height = kind.shape(known)
    if ax is not None:
        _on_axes(kind, known, list(np.ravel(ax)), over, len(known) if kind.per_run else rows * columns)
        return ax
    picture = new_figure(max(WIDTH_IN, 3.4 * columns), 0.8 + rows * height)
    panels = list(picture.subplots(rows, columns, squeeze=False).ravel())
    kind.draw(known, panels, over)
    _entitle(picture, panels, kind, known, over)
    return picture


def _on_axes(kind: Kind, curves: Sequence[Curve], panels: list[Any], over: Over, count: int) -> None:
    """Draw on the caller's axes: as many as the figure has panels, or one for the main panel of those without one each.

    They keep their titles, and have a legend in the size of the caller's font; a map has it above, as it hides walls.
    """
    if not all(hasattr(one, "get_legend_handles_labels") for one in panels):
        raise InputError("ax", f"found {shown(panels)}", "Axes of matplotlib, one or several")
    if len(panels) != count and (kind.per_run or len(panels) != 1):
        raise InputError("ax", f"found {len(panels)} axes", f"{count}")
    kind.draw(curves, panels, over)
    is_map = kind.draw in (_maps, _explorations)
    place: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": 2} if is_map else {}
    for one in panels:
        in_millimetres(one)
        handles, names = one.get_legend_handles_labels()
        if names:
            names = [textwrap.fill(name, _COLUMN_LETTERS) for name in names]
            one.legend(handles, names, frameon=False, fontsize="small", **place)


def _entitle(picture: Any, panels: Sequence[Any], kind: Kind, curves: Sequence[Curve], over: Over) -> None:
    """End a new picture: its titles, what differs between its runs, legends, and short lengths in millimetres."""
    runs = [one for curve in curves for one in curve.samples]
    for ax in panels:
        in_millimetres(ax)
    if kind.draw in (_maps, _explorations):
        rows, columns, _ = kind.shape(curves)
        for ax, curve in zip(panels, curves, strict=False):
            ax.set_title(f"{curve.name}: {curve.run.outcome}" if curve.name else curve.run.title, fontsize="medium")
        for ax in panels[len(curves) :]:
            ax.set_axis_off()
        width = WIDTH_IN if columns > 1 else MAP_WIDTH_IN
        heights = [map_height(ax, width / columns) for ax in panels[: len(curves)]]
        picture.set_size_inches(width, rows * max(heights) + 0.4 * (len(curves) > 1))
        legend(picture, 5 if columns == 1 else 4)
    elif kind.shape(curves)[1] > 1:
        legend(picture, columns_for(panels[0]))
    else:
        for ax in panels[:1] if kind.draw is _errors else panels:
            legend_above(ax)
    if len(runs) > 1:
        title = kind.title + (" over the distance travelled" if over == "distance" else "")
        picture.suptitle(f"{title}\n{differences([one.fields for one in runs])}", fontsize=9.0)
    elif kind.draw not in (_maps, _explorations):
        picture.suptitle(runs[0].run.title if runs[0].run is not None else runs[0].name, fontsize=9.0)


def _planes(curves: Sequence[Curve], panels: list[Any], _: Over, draw: Callable[[Any, Any], None]) -> None:
    """One panel per run; panels of one scene share their limits."""
    for ax, curve in zip(panels, curves, strict=False):
        draw(ax, curve.trace)
    if len({curve.trace.config.scene for curve in curves}) == 1:
        _share(panels[: len(curves)], "xy")


_maps, _explorations = (functools.partial(_planes, draw=draw) for draw in (draw_map, draw_exploration))


def _share(panels: Sequence[Any], axes: str) -> None:
    """Give panels the limits that all of their curves need, along x, y or both."""
    for name in axes:
        limits = [getattr(ax, f"get_{name}lim")() for ax in panels]
        for ax in panels:
            getattr(ax, f"set_{name}lim")(min(low for low, _ in limits), max(high for _, high in limits))


def _errors(curves: Sequence[Curve], panels: list[Any], over: Over) -> None:
    """Errors of x, y and heading in their bounds, a column per run; magnitudes on two panels, or one."""
    if len(panels) == len(overtime.COMPONENTS) * len(curves):
        for component in range(len(overtime.COMPONENTS)):
            row = panels[component * len(curves) : (component + 1) * len(curves)]
            for k, (ax, curve) in enumerate(zip(row, curves, strict=True)):
                overtime.draw_error(ax, curve.trace, component, CYCLE[k % len(CYCLE)], over)
                if component == 0 and curve.name:
                    ax.annotate(curve.name, (0.01, 0.97), xycoords="axes fraction", va="top", fontsize="small")
                ax.label_outer()
            _share(row, "y")
        return
    for ax, (quantity, label, scale) in zip(panels, _ERRORS, strict=False):
        for k, curve in enumerate(curves):
            _draw_spread(ax, curve, quantity, scale, over, k)
        ax.set(xlabel=overtime.AXIS_LABELS[over], ylabel=label)
        ax.set_ylim(bottom=0.0)
        ax.label_outer()


def _draw_spread(ax: Any, curve: Curve, quantity: str, scale: float, over: Over, k: int) -> None:
    """Draw the median of an error over the runs and the band of 10 to 90 %; of one run it and its running mean."""
    values = scale * resampled(curve.errors(), quantity, PLACE[over])
    low, middle, high = (values.quantile(share, axis=1).to_numpy() for share in _QUANTILES)
    style = overtime.style_of(k)
    if len(curve.samples) > 1:
        ax.plot(values.index, middle, label=curve.label, **style)
        ax.fill_between(values.index, low, high, color=style["color"], alpha=0.18, linewidth=0.0)
    else:
        ax.plot(values.index, middle, color=style["color"], linewidth=0.6, alpha=0.4)
        ax.plot(values.index, overtime.running_mean(middle), label=curve.label or "running mean", **style)
    ax.margins(x=0.0)


def _nees(curves: Sequence[Curve], panels: list[Any], over: Over) -> None:
    """NEES of each run at its keyframes, or averaged over the runs of each group, with what it is worth."""
    found, drawn = [], []
    for k, curve in enumerate(curves):
        frames = curve.errors()
        if len(frames) > 1:
            values = resampled(frames, "nees", PLACE[over]).mean(axis=1)
            places, nees = values.index.to_numpy(), values.to_numpy()
        else:
            known = frames[0].dropna(subset=["nees"])
            places, nees = known[PLACE[over]].to_numpy(), known["nees"].to_numpy()
        found.append(_worth(curve, [one["nees"].to_numpy() for one in frames]))
        drawn.append(nees)
        overtime.draw_nees(panels[0], places, nees, found[-1], curve.label, overtime.style_of(k))
    overtime.scale_nees(panels[0], drawn, found, min(len(curve.errors()) for curve in curves), over)


def _worth(curve: Curve, nees: Sequence[Any]) -> Consistency:
    return pooled(np.array([np.nanmean(one) for one in nees]), numbers(curve.samples, EFFECTIVE), nees)


def _nis(curves: Sequence[Curve], panels: list[Any], _: Over) -> None:
    """One panel per run: the band depends on the number of matched landmarks."""
    for k, (ax, curve) in enumerate(zip(panels, curves, strict=True)):
        overtime.draw_nis(ax, curve.trace, curve.name, k)
        ax.label_outer()
    _share(panels, "xy")


def _stages(curves: Sequence[Curve], panels: list[Any], _: Over) -> None:
    overtime.draw_stages(panels[0], [curve.samples[0].metrics for curve in curves], [curve.name for curve in curves])


def _coverage(curves: Sequence[Curve], panels: list[Any], _: Over) -> None:
    for k, curve in enumerate(curves):
        overtime.draw_coverage(panels[0], curve.trace, curve.name, k)


def _relative_errors(curves: Sequence[Curve], panels: list[Any], _: Over) -> None:
    """Relative pose error against the length of path: the median over a group's runs, and 10 to 90 %."""
    apart = min(0.12, 0.6 / len(curves))
    for ax, (part, label) in zip(panels, _RELATIVE, strict=False):
        for k, curve in enumerate(curves):
            rows = [numbers(curve.samples, f"rpe_{part}_{length}m") for length in RPE_LENGTHS_M]
            places = np.arange(len(rows)) + (k - 0.5 * (len(curves) - 1)) * apart
            low, middle, high = np.array(
                [np.quantile(row, _QUANTILES) if len(row) else 3 * [np.nan] for row in rows]
            ).T  # (3, lengths)
            bars = np.abs([low - middle, high - middle]) if len(curve.samples) > 1 else None
            style = overtime.style_of(k) | {"marker": "o", "markersize": 4.5, "elinewidth": 1.8, "capsize": 3.0}
            ax.errorbar(places, middle, bars, label=curve.label or "root mean square", **style)
        ax.set_xticks(np.arange(len(RPE_LENGTHS_M)), [f"{length}" for length in RPE_LENGTHS_M])
        ax.set(xlabel="length of path [m]", ylabel=label)
        ax.set_ylim(0.0, 1.1 * ax.get_ylim()[1])


def _in_three(curves: Sequence[Curve]) -> tuple[int, int, float]:
    columns = min(len(curves), 3)
    return -(-len(curves) // columns), columns, 3.0


def _of_errors(curves: Sequence[Curve]) -> tuple[int, int, float]:
    is_detailed = len(curves) <= 3 and all(curve.run is not None for curve in curves)
    return (len(overtime.COMPONENTS), len(curves), 1.9) if is_detailed else (2, 1, 2.5)


KINDS = {
    "map": Kind(
        "Maps", "Map: true walls, detected walls, landmarks with 95 % ellipses, planned and driven paths.",
        _maps, lambda one: one.run is not None, "its record", _in_three, True,
    ),
    "error": Kind(
        "Pose error", "Error of the pose at scans and keyframes, with the three-sigma bounds of the estimator.",
        _errors, Curve.errors, "the truth at keyframes", _of_errors,
    ),
    "rpe": Kind(
        "Relative pose error by length of path", "Root mean square error of the motion over each length of path.",
        _relative_errors, lambda one: len(numbers(one.samples, f"rpe_trans_m_{RPE_LENGTHS_M[0]}m")),
        "the truth over at least a metre of path", lambda _: (1, 2, 3.0),
    ),
    "nees": Kind(
        "Consistency of the pose: NEES",
        "Consistency of the pose: normalised estimation error squared (NEES), 3 on average if consistent.",
        _nees, lambda one: any(found["nees"].notna().any() for found in one.errors()), "the truth at keyframes",
        lambda _: (1, 1, 3.2),
    ),
    "nis": Kind(
        "Consistency of the matches: NIS", "Normalised innovation squared (NIS) per dof, 1 on average if consistent.",
        _nis, lambda one: one.run is not None and any(found.dof for found in one.trace.associations),
        "matched landmarks", lambda curves: (len(curves), 1, 2.0), True,
    ),
    "stages": Kind(
        "Computing time per stage", "Computing time of the stages of a keyframe.", _stages,
        lambda one: any(key.startswith("stage_ms_mean.") for key in one.samples[0].metrics), "stage times",
        lambda curves: (1, 1, 2.6 + 0.6 * len(curves)),
    ),
    "coverage": Kind(
        "Area seen", "Seen share of the visible area, over time.", _coverage,
        lambda one: one.run is not None and one.trace.key_truths and one.trace.scene, "the truth and its scene",
        lambda _: (1, 1, 3.0),
    ),
    "exploration": Kind(
        "Exploration", "Seen area, remaining frontiers, and planned paths, pale to dark over time.", _explorations,
        lambda one: one.run is not None and one.trace.config.task == "explore" and one.trace.plans and one.trace.grid,
        "an exploration", _in_three, True,
    ),
}  # fmt: skip
"""the figures by their names"""
OF_GROUPS = ("error", "nees", "rpe")
"""those of them that can be drawn of groups"""
