"""Figures over time: errors with their 3-sigma bounds, consistency and coverage; and the time of each stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.evaluation import metrics
from sixthsense.evaluation.coverage import coverage_of
from sixthsense.evaluation.curves import (
    Over,
    defined_poses,
    key_places,
    key_poses,
    key_times,
    scan_covariances,
    scan_places,
)
from sixthsense.figures.plot import CYCLE, ESTIMATE, TRUTH
from sixthsense.record.trace import STAGES, Trace

BAND = {"color": "#BBBBBB", "alpha": 0.5, "linewidth": 0.0, "zorder": 0}
"""style of bands in which a consistent curve lies"""


@dataclass(frozen=True, slots=True)
class Component:
    """Label and unit of one component of the pose."""

    name: str
    """name on the axis"""
    unit: str
    """unit on the axis"""
    scale: float
    """factor from metres or radians to the unit"""


COMPONENTS = (Component("x", "m", 1.0), Component("y", "m", 1.0), Component("heading", "°", float(np.degrees(1.0))))


AXIS_LABELS = {"time": "time [s]", "distance": "distance travelled [m]"}
"""of the axes that curves are drawn over"""


def draw_tube(ax: Any, t: Array, error: Array, bound: Array, band: str, label: str = "error", **style: Any) -> None:
    """Draw an error (K,) with its label within a band of +-`bound` (K,), whose label is `band`."""
    ax.fill_between(t, -bound, bound, label=band, **BAND)
    ax.axhline(0.0, color=TRUTH, linewidth=0.5)
    ax.plot(t, error, label=label, **style)
    ax.margins(x=0.0)


def draw_error(ax: Any, trace: Trace, component: int, color: str = ESTIMATE, over: Over = "time") -> None:
    """Draw the error of x, y or heading (component 0, 1, 2) at every scan within its ±3σ bounds, and at keyframes.

    The trace must have truth. Metrics and tables count every scan. Bounds are at keyframes alone where the record has
    no covariances of other scans.
    """
    shown = COMPONENTS[component]
    poses, covs = key_poses(trace.key_estimates)

    def error(found: Array, truths: Sequence[Array]) -> Array:
        off = (found - np.array(truths).reshape(-1, 3))[:, component]
        return np.asarray(shown.scale * (wrap_angle(off) if component == 2 else off))

    scans, keys = error(np.array(trace.estimates).reshape(-1, 3), trace.truths), error(poses, trace.key_truths)
    places, of_key = scan_places(trace, over), key_places(trace, over)
    at, band = of_key, "±3σ at keyframes"  # noqa: RUF001
    if trace.since_covs:
        at, covs, band = places, scan_covariances(trace), "±3σ"  # noqa: RUF001
    of_scans, of_keys = (_with_unit(_rms(one), shown.unit) for one in (scans, keys))
    place = {"transform": ax.transAxes, "ha": "right", "va": "bottom", "fontsize": "small"}
    ax.text(0.99, 0.03, f"RMS of scans {of_scans}, of keyframes {of_keys}", **place)
    bound = 3.0 * np.sqrt(np.maximum(covs[:, component, component], 0.0)) * shown.scale
    ax.fill_between(at, -bound, bound, label=band, **BAND)
    ax.axhline(0.0, color=TRUTH, linewidth=0.5)
    ax.plot(places, scans, color=color, linewidth=0.7, label="scans")
    ax.plot(of_key, keys, color=color, linewidth=0.0, marker=".", markersize=2.5, label="keyframes")
    ax.margins(x=0.0)
    ax.set(xlabel=AXIS_LABELS[over], ylabel=f"error of {shown.name} [{shown.unit}]")


def draw_nees(
    ax: Any,
    trace: Trace,
    color: str = ESTIMATE,
    label: str | None = None,
    band: bool = True,
    over: Over = "time",
) -> None:
    """Draw the pose's NEES at keyframes, in world coordinates, with the 95 % band of one run.

    Its mean in right-invariant ones is among the metrics. The trace must have truth. The curve begins where the
    covariance has full rank. Use `band` for the first run on the axes only.
    """
    poses, truth, covs = defined_poses(trace.key_estimates, trace.key_truths)
    values = metrics.nees_world(poses - truth, covs)
    limits = metrics.nees_band(1)
    if band:
        ax.axhspan(*limits, label="95 % band", **BAND)
        ax.axhline(3.0, color=TRUTH, linewidth=0.5)
    if len(values):
        summary = f"mean {values.mean():.2f}, {100 * metrics.share_in_band(values, limits):.0f} % in band"
        t = key_places(trace, over)[-len(values) :]
        ax.plot(t, values, color=color, linewidth=1.0, label=_told(label, summary))
    ax.set_yscale("log")
    # A NEES close to 0 must not determine the scale.
    _rise(ax, 0.03, max(30.0, 1.5 * values.max(initial=0.0)))
    ax.set(xlabel=AXIS_LABELS[over], ylabel="pose NEES at keyframes [1]")
    ax.margins(x=0.0)


def draw_nis(ax: Any, trace: Trace, color: str = ESTIMATE, label: str | None = None) -> None:
    """Draw each keyframe's normalised innovation squared per degree of freedom, with its 95 % band.

    The band depends on the number of matched landmarks in this run.
    """
    dof = np.array([association.dof for association in trace.associations], dtype=np.int64)
    nis = np.array([association.nis for association in trace.associations])
    t = key_times(trace)
    with np.errstate(divide="ignore", invalid="ignore"):
        per_dof = np.where(dof > 0, nis / dof, np.nan)  # a gap in the curve without a match
        low, high = (np.where(dof > 0, chi_square_quantile(share, dof) / dof, np.nan) for share in (0.025, 0.975))
    ax.fill_between(t, low, high, label="95 % band", **BAND)
    ax.axhline(1.0, color=TRUTH, linewidth=0.5)
    if dof.any():
        label = _told(label, f"mean {nis.sum() / dof.sum():.2f}")
        ax.plot(t, per_dof, color=color, linewidth=1.0, marker=".", markersize=2.5, label=label)
    _rise(ax, 0.0, 1.05 * max([1.0, *per_dof[dof > 0], *high[dof > 0]]))
    ax.set(xlabel="time [s]", ylabel="NIS per dof [1]")
    ax.margins(x=0.0)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _with_unit(value: float, unit: str) -> str:
    """A length below a decimetre in millimetres, anything else in its unit."""
    return f"{1e3 * value:.3g} mm" if unit == "m" and value < 0.1 else f"{value:.3g} {unit}".replace(" °", "°")


def _rise(ax: Any, low: float, high: float) -> None:
    """Set the limits of y, but keep a higher upper limit set before on these or shared axes."""
    ax.set_ylim(low, high if ax.get_autoscaley_on() else max(high, ax.get_ylim()[1]))


def _told(label: str | None, summary: str) -> str:
    return summary if label is None else f"{label}: {summary}"


def draw_coverage(ax: Any, trace: Trace, color: str = ESTIMATE, label: str | None = None) -> None:
    """Draw the seen share of the visible area over time.

    The trace must have truth and a scene.
    """
    area, share = coverage_of(trace)
    t = 1e-9 * (np.array(trace.stamps_ns, dtype=np.int64) - trace.stamps_ns[0]).astype(np.float64)
    label = _told(label, f"{area.square_metres:.0f} m² visible")
    ax.plot(t, 100.0 * share, color=color, linewidth=1.4, label=label)
    ax.set(ylim=(0.0, 102.0), xlabel="time [s]", ylabel="seen share of the visible area [%]")
    ax.margins(x=0.0)


def draw_stages(ax: Any, runs: Sequence[Mapping[str, Any]], labels: Sequence[str | None] = (None,)) -> None:
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


def _ms(value: float) -> str:
    """Two significant digits without an exponent."""
    return "" if np.isnan(value) else f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"
