"""Panels of groups of runs: medians and bands of errors, NEES averaged over runs, and relative pose errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.evaluation.curves import Over
from sixthsense.evaluation.groups import Group, resampled
from sixthsense.evaluation.metrics import RPE_LENGTHS_M, nees_band
from sixthsense.figures.canvas import WIDTH_IN, Canvas
from sixthsense.figures.overtime import AXIS_LABELS
from sixthsense.figures.plot import CYCLE, TRUTH

ERRORS = {"position_m": ("position error [m]", 1.0), "heading_rad": ("heading error [°]", float(np.degrees(1.0)))}
"""by field of the curves: label of the axis, and factor to its unit"""
RELATIVE = {"trans_m": "relative translation error [m]", "rot_deg": "relative rotation error [°]"}
"""by part of the metric's key: label of the axis"""

_QUANTILES = (10.0, 50.0, 90.0)
"""per cent of the runs: limits of a band, and its median"""


def style_of(k: int) -> dict[str, Any]:
    """Colour and line of the k-th group."""
    return {"color": CYCLE[k % len(CYCLE)], "linestyle": "-" if k < len(CYCLE) else "--"}


def draw_spread(ax: Any, group: Group, quantity: str, over: Over, k: int = 0) -> None:
    """Draw the median of an error over the runs of a group and, of several runs, the band of 10 to 90 %.

    `quantity` is a key of `ERRORS`; `k` is the group's number, for its colour.
    """
    label, scale = ERRORS[quantity]
    found = group.curves()
    places, values = resampled(found, quantity, over)
    low, middle, high = np.nanpercentile(scale * values, _QUANTILES, axis=0)
    ax.plot(places, middle, linewidth=1.4, label=_counted(group.name, len(found)), **style_of(k))
    if len(found) > 1:
        ax.fill_between(places, low, high, color=style_of(k)["color"], alpha=0.18, linewidth=0.0)
    ax.set(xlabel=AXIS_LABELS[over], ylabel=label)
    ax.margins(x=0.0)


def draw_mean_nees(ax: Any, groups: Sequence[Group], over: Over) -> None:
    """Draw the pose's NEES averaged over the runs of each group, and the 95 % band of such an average.

    The band is that of the group with the fewest runs.
    """
    curves = [group.curves() for group in groups]
    fewest = min(range(len(groups)), key=lambda k: len(curves[k]))
    means: list[Array] = []
    for k, (group, found) in enumerate(zip(groups, curves, strict=True)):
        places, values = resampled(found, "nees", over)
        mean = np.nanmean(values, axis=0)
        means.append(mean)
        if k == fewest:
            count = np.isfinite(values).sum(axis=0)
            low, high = (chi_square_quantile(share, 3 * count) / count for share in (0.025, 0.975))
            band = "95 % band" if len(found) == 1 else f"95 % band of the mean of {len(found)} runs"
            ax.fill_between(places, low, high, color="#BBBBBB", alpha=0.5, linewidth=0.0, zorder=0, label=band)
        label = f"{_counted(group.name, len(found))}{': ' * bool(group.name)}mean {mean.mean():.2f}"
        ax.plot(places, mean, linewidth=1.2, label=label, **style_of(k))
    ax.axhline(3.0, color=TRUTH, linewidth=0.5)
    _scale_nees(ax, means, len(curves[fewest]))
    ax.set(xlabel=AXIS_LABELS[over], ylabel="pose NEES [1]")
    ax.margins(x=0.0)


def _scale_nees(ax: Any, means: Sequence[Array], runs: int) -> None:
    """A logarithmic axis with the band of so many runs and the curves, but for single values close to 0."""
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

    low, high = nees_band(runs)
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    bottom = min(float(np.percentile(mean, 5.0)) for mean in means)
    top = max(float(mean.max()) for mean in means)
    ax.set_ylim(0.7 * min(low, bottom), 1.4 * max(high, top))


def draw_relative_errors(ax: Any, groups: Sequence[Group], part: str) -> None:
    """Draw the relative pose error against the length of path: the median over a group's runs, and 10 to 90 %.

    `part` is a key of `RELATIVE`. A length that no run of a group has driven has no mark.
    """
    apart, top = min(0.12, 0.6 / len(groups)), 0.0
    for k, group in enumerate(groups):
        rows = [group.metric(f"rpe_{part}_{length}m") for length in RPE_LENGTHS_M]
        places = np.arange(len(rows)) + (k - 0.5 * (len(groups) - 1)) * apart
        spread = np.array([np.percentile(row, _QUANTILES) if len(row) else 3 * [np.nan] for row in rows]).T
        runs = max(map(len, rows))
        bars = np.abs(spread[[0, 2]] - spread[1]) if runs > 1 else None
        style = {"marker": "o", "markersize": 4.5, "linewidth": 1.2, "elinewidth": 1.8, "capsize": 3.0}
        top = max(top, float(np.nanmax(spread)))
        ax.errorbar(places, spread[1], bars, label=_counted(group.name, runs), **style_of(k), **style)
    ax.set_xticks(np.arange(len(RPE_LENGTHS_M)), [f"{length}" for length in RPE_LENGTHS_M])
    ax.set(xlabel="length of path [m]", ylabel=RELATIVE[part], ylim=(0.0, 1.1 * top or 1.0))


def draw_errors(groups: Sequence[Group], canvas: Canvas) -> None:
    """Position and heading error; on a single Axes the position's."""
    quantities = list(ERRORS)[:1] if canvas.is_one else list(ERRORS)
    panels = canvas.panels(len(quantities), 1, WIDTH_IN, 7.0, sharex=True)
    for ax, quantity in zip(panels, quantities, strict=True):
        for k, group in enumerate(groups):
            draw_spread(ax, group, quantity, canvas.over, k)
        ax.set_ylim(bottom=0.0)
    if canvas.given is None:
        panels[0].set_xlabel("")
    canvas.label(panels[0])


def draw_consistency(groups: Sequence[Group], canvas: Canvas) -> None:
    """NEES averaged over the runs."""
    (ax,) = canvas.panels(1, 1, WIDTH_IN, 5.0)
    draw_mean_nees(ax, groups, canvas.over)
    canvas.label(ax)


def draw_relative(groups: Sequence[Group], canvas: Canvas) -> None:
    """Relative pose error, translation and rotation; on a single Axes the translation's."""
    parts = list(RELATIVE)[:1] if canvas.is_one else list(RELATIVE)
    panels = canvas.panels(1, len(parts), WIDTH_IN, 4.6)
    for ax, part in zip(panels, parts, strict=True):
        draw_relative_errors(ax, groups, part)
    if any(group.name for group in groups):
        canvas.label_below(panels)


def has_relative(group: Group) -> bool:
    """Whether a run of the group has driven far enough for a relative pose error."""
    return len(group.metric(f"rpe_trans_m_{RPE_LENGTHS_M[0]}m")) > 0


def has_nees(group: Group) -> bool:
    """Whether a run of the group has a NEES."""
    return any(np.isfinite(one.nees).any() for one in group.curves())


def _counted(name: str, runs: int) -> str:
    return f"{name}, {runs} runs" if runs > 1 else name
