"""Curves of runs: errors with their 3-sigma bounds, consistency, coverage, and the time of each stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.evaluation.consistency import Consistency, short
from sixthsense.evaluation.coverage import coverage_of
from sixthsense.evaluation.curves import Over, key_places, key_poses, scan_covariances, scan_places
from sixthsense.evaluation.metrics import nees_band
from sixthsense.figures.plot import CYCLE, ESTIMATE, TRUTH
from sixthsense.record.trace import STAGES, Trace

BAND = {"color": "#BBBBBB", "alpha": 0.5, "linewidth": 0.0, "zorder": 0}
"""style of bands in which a consistent curve lies"""
COMPONENTS = (("x", "m", 1.0), ("y", "m", 1.0), ("heading", "°", float(np.degrees(1.0))))
"""of the pose: name, unit of the axis, and factor to it from metres or radians"""
AXIS_LABELS = {"time": "time [s]", "distance": "distance travelled [m]"}
"""of the axes that curves are drawn over"""

_WINDOWS = 15  # of running means, along a curve
_FEW_DECADES = 50.0  # highest over lowest value of an axis of NEES: beyond there are fewer ticks
_DASHES = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 1.5, 1.5, 1.5)))


def style_of(k: int) -> dict[str, Any]:
    """Colour, line and width of the k-th curve: the later, the thinner and dashed, so that equal curves show each.

    Widths are those of Matplotlib's `lines.linewidth`.
    """
    from matplotlib import rcParams

    color, dashes = CYCLE[k % len(CYCLE)], _DASHES[k % len(_DASHES)]
    width = max(0.7, 1.6 - 0.2 * k) * float(rcParams["lines.linewidth"])
    return {"color": color, "linestyle": dashes, "linewidth": width}


def running_mean(values: Array) -> Array:
    """(N,) means of the values (N,) around each, over a fifteenth of all of them; NaN are left out."""
    import pandas as pd

    return np.asarray(pd.Series(values).rolling(max(3, len(values) // _WINDOWS), center=True, min_periods=1).mean())


def draw_tube(ax: Any, places: Array, error: Array, bound: Array, band: str, **style: Any) -> None:
    """Draw an error (K,) with its running mean within a band of +-`bound` (K,), whose label is `band`."""
    ax.fill_between(places, -bound, bound, label=band, **BAND)
    ax.axhline(0.0, color=TRUTH, linewidth=0.5)
    ax.plot(places, error, linewidth=0.7, alpha=0.6, **style)
    ax.plot(places, running_mean(error), color=TRUTH, linewidth=1.1, label="running mean")
    ax.margins(x=0.0)


def draw_error(ax: Any, trace: Trace, component: int, color: str = ESTIMATE, over: Over = "time") -> None:
    """Draw the error of x, y or heading (component 0, 1, 2) at every scan within its ±3σ bounds, and at keyframes.

    The trace must have truth. Metrics and tables count every scan.
    """
    name, unit, scale = COMPONENTS[component]
    poses, _ = key_poses(trace.key_estimates)

    def error(found: Array, truths: Sequence[Array]) -> Array:
        off = (found - np.array(truths).reshape(-1, 3))[:, component]
        return np.asarray(scale * (wrap_angle(off) if component == 2 else off))

    scans, keys = error(np.array(trace.estimates).reshape(-1, 3), trace.truths), error(poses, trace.key_truths)
    places, of_key = scan_places(trace, over), key_places(trace, over)
    bound = 3.0 * np.sqrt(np.maximum(scan_covariances(trace)[:, component, component], 0.0)) * scale
    draw_tube(ax, places, scans, bound, "±3σ", color=color, label="scans")  # noqa: RUF001
    ax.plot(of_key, keys, color=color, linewidth=0.0, marker=".", markersize=3.0, label="keyframes")
    of_scans, of_keys = (_with_unit(_rms(one), unit) for one in (scans, keys))
    place = {"transform": ax.transAxes, "ha": "right", "va": "bottom", "fontsize": "x-small"}
    ax.text(0.99, 0.03, f"RMS {of_scans}, keyframes {of_keys}", **place).set_in_layout(False)
    ax.set(xlabel=AXIS_LABELS[over], ylabel=f"error of {name} [{unit}]")


def draw_nees(
    ax: Any, places: Array, nees: Array, found: Consistency, label: str = "", style: Mapping[str, Any] | None = None
) -> None:
    """Draw NEES (K,), NaN where not defined, as points with their running mean; the label has the verdict.

    `found` is what the NEES are worth together. `style` is that of the curve, see `style_of`.
    """
    style = style or style_of(0)
    low, high = map(short, found.band)
    words = f"mean {short(found.nees)} ({low} to {high}: {found.outcome})"
    ax.plot(places, nees, color=style["color"], linestyle="", marker=".", markersize=3.0, alpha=0.35)
    ax.plot(places, running_mean(nees), label=f"{label}: {words}" if label else words, **style)
    ax.margins(x=0.0)


def scale_nees(
    ax: Any, nees: Sequence[Array], found: Sequence[Consistency], runs: int = 1, over: Over = "time"
) -> None:
    """Draw the bands and set a logarithmic axis that shows them and the curves, but for single values close to 0.

    The wide band is that of a mean over `runs` at one place, the narrow one that of the only mean, if there is one.
    """
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

    dof = found[0].dof
    low, high = nees_band(runs, dof)
    of = "a pose" if runs == 1 else f"the mean of {runs} runs"
    ax.axhspan(low, high, label=f"95 % band of {of}", **BAND)
    if len(found) == 1:
        ax.axhspan(*found[0].band, **BAND | {"color": "#888888"}, label="95 % band of the mean")
    ax.axhline(dof, color=TRUTH, linewidth=0.5)
    together = np.concatenate([one[np.isfinite(one)] for one in nees])
    bottom, top = np.percentile(together, [2.0, 100.0]) if len(together) else (low, high)
    bottom, top = max(0.7 * min(low, bottom), 0.02), 1.4 * max(high, top)
    ax.set_yscale("log")
    ax.set_ylim(bottom, top)
    subs = (1.0, 2.0, 3.0, 5.0) if top < _FEW_DECADES * bottom else (1.0, 3.0)
    ax.yaxis.set_major_locator(LogLocator(subs=subs, numticks=12))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.set(xlabel=AXIS_LABELS[over], ylabel="NEES [1]")


def draw_nis(ax: Any, trace: Trace, label: str = "", k: int = 0) -> None:
    """Draw each keyframe's normalised innovation squared per degree of freedom, with its 95 % band.

    The band depends on the number of matched landmarks in this run.
    """
    dof = np.array([association.dof for association in trace.associations], dtype=np.int64)
    nis = np.array([association.nis for association in trace.associations])
    places = key_places(trace, "time")
    with np.errstate(divide="ignore", invalid="ignore"):
        per_dof = np.where(dof > 0, nis / dof, np.nan)  # a gap in the curve without a match
        low, high = (np.where(dof > 0, chi_square_quantile(share, dof) / dof, np.nan) for share in (0.025, 0.975))
    ax.fill_between(places, low, high, label="95 % band", **BAND)
    ax.axhline(1.0, color=TRUTH, linewidth=0.5)
    if dof.any():
        words = f"mean {nis.sum() / dof.sum():.2f}"
        ax.plot(places, per_dof, linewidth=0.0, marker=".", markersize=3.0, alpha=0.5, color=style_of(k)["color"])
        ax.plot(places, running_mean(per_dof), label=f"{label}: {words}" if label else words, **style_of(k))
    ax.set_ylim(0.0, 1.05 * max([1.0, *per_dof[dof > 0], *high[dof > 0]]))
    ax.set(xlabel="time [s]", ylabel="NIS per dof [1]")
    ax.margins(x=0.0)


def draw_coverage(ax: Any, trace: Trace, label: str = "", k: int = 0) -> None:
    """Draw the seen share of the visible area over time; the trace must have truth and a scene."""
    area, share = coverage_of(trace)
    words = f"{area.square_metres:.0f} m² visible"
    ax.plot(scan_places(trace, "time"), 100.0 * share, label=f"{label}: {words}" if label else words, **style_of(k))
    ax.set(ylim=(0.0, 102.0), xlabel="time [s]", ylabel="seen share of the visible area [%]")
    ax.margins(x=0.0)


def draw_stages(ax: Any, runs: Sequence[Mapping[str, Any]], labels: Sequence[str]) -> None:
    """Draw the mean time of each stage per keyframe, milliseconds, with a bar for each run's metrics."""
    stages = [stage for stage in STAGES if any(f"stage_ms_mean.{stage}" in run for run in runs)]
    height = 0.8 / max(len(runs), 1)
    for k, run in enumerate(runs):
        values = np.array([run.get(f"stage_ms_mean.{stage}", np.nan) for stage in stages], dtype=np.float64)
        places = np.arange(len(stages)) + (k - 0.5 * (len(runs) - 1)) * height
        words = [label for label in labels[k : k + 1] if label]
        if "scan_ms_p50" in run:
            words.append(f"keyframe: median {_ms(run['scan_ms_p50'])} ms, 99 % below {_ms(run['scan_ms_p99'])} ms")
        bars = ax.barh(places, values, height, color=CYCLE[k % len(CYCLE)], label=": ".join(words) or None)
        ax.bar_label(bars, fmt=_ms, padding=3, fontsize=min(8.0, 30.0 * height))
    ax.set_yticks(np.arange(len(stages)), stages)
    ax.invert_yaxis()
    ax.set_xlabel("mean time per keyframe [ms]")
    ax.margins(x=0.1)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _with_unit(value: float, unit: str) -> str:
    """A length below a decimetre in millimetres, anything else in its unit."""
    return f"{1e3 * value:.3g} mm" if unit == "m" and value < 0.1 else f"{value:.3g} {unit}".replace(" °", "°")


def _ms(value: float) -> str:
    """Two significant digits without an exponent."""
    return "" if np.isnan(value) else f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"
