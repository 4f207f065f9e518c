"""The figure of an audit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sixthsense.auditing.pairing import Errors
from sixthsense.auditing.poses import Frame
from sixthsense.auditing.statistics import AXES, Findings
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.figures.overtime import BAND, draw_tube
from sixthsense.figures.picture import Picture
from sixthsense.figures.plot import CYCLE, ESTIMATE, TRUTH, new_figure

_WIDTH_IN, _HEIGHT_IN, _PER_AXIS_IN = 11.0, 2.2, 1.65
_MOST_POINTS = 4000  # of a curve; more are not to be seen


def draw(runs: Sequence[Errors], found: Findings, frame: Frame, title: str) -> Picture:
    """Errors of the first run in their tubes at the left; NEES over time and chi-square Q-Q at the right."""
    names = AXES[frame, found.dof]
    picture = new_figure(_WIDTH_IN, _HEIGHT_IN + _PER_AXIS_IN * len(names))
    grid = picture.add_gridspec(2 * len(names), 2, width_ratios=(1.25, 1.0))
    tubes: list[Any] = []
    for k, name in enumerate(names):
        tubes.append(picture.add_subplot(grid[2 * k : 2 * k + 2, 0], sharex=tubes[0] if tubes else None))
        draw_axis(tubes[-1], runs[0], frame, k, name)
        tubes[-1].tick_params(labelbottom=k == len(names) - 1)
    tubes[-1].set_xlabel("time [s]")
    tubes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, borderaxespad=0.2)
    draw_nees(picture.add_subplot(grid[: len(names), 1]), runs, found)
    draw_quantiles(picture.add_subplot(grid[len(names) :, 1]), runs, found)
    picture.suptitle(title, fontsize=11.0)
    return picture


def draw_axis(ax: Any, run: Errors, frame: Frame, axis: int, name: str) -> None:
    """Draw the error on one axis of a frame with the stated +-3 sigma."""
    rows = _some(len(run.stamps_ns))
    error, cov = run.in_axes(frame)
    scale, unit = (1.0, "m") if axis < run.orientations.shape[1] else (float(np.degrees(1.0)), "°")
    bound = 3.0 * scale * np.sqrt(cov[rows, axis, axis])
    style = {"color": ESTIMATE, "linewidth": 0.9}
    draw_tube(ax, _seconds(run)[rows], scale * error[rows, axis], bound, "stated ±3σ", **style)  # noqa: RUF001
    ax.set_ylabel(f"{name} [{unit}]")


def draw_nees(ax: Any, runs: Sequence[Errors], found: Findings) -> None:
    """Draw the NEES of each pose, the means of equal parts of the time, and the band of the mean."""
    label: str | None = f"NEES: mean {found.nees:.3g}, {100.0 * found.inside:.0f} % inside 95 %"
    for k, run in enumerate(runs):
        rows = _some(len(run.stamps_ns))
        style = {"color": CYCLE[k % len(CYCLE)], "linewidth": 0.5, "alpha": 0.45}
        ax.plot(_seconds(run)[rows], run.nees[rows], label=label, **style)
        label = None
    end = max(float(_seconds(run)[-1]) for run in runs)
    edges = np.linspace(0.0, end, len(found.parts) + 1)
    ax.stairs(np.array(found.parts), edges, baseline=None, color=TRUTH, linewidth=1.6, label="mean of each part")
    ax.axhspan(*found.band, label="95 % band of the mean", **BAND)
    ax.set_yscale("log")
    together = np.concatenate([run.nees for run in runs])
    ax.set_ylim(max(float(np.percentile(together, 1.0)), 0.02), 1.5 * max(float(together.max()), 2.0 * found.band[1]))
    ax.set(xlabel="time [s]", ylabel="NEES [1]")
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    ax.legend(frameon=False, ncols=2, fontsize="small", **above)
    ax.margins(x=0.0)


def draw_quantiles(ax: Any, runs: Sequence[Errors], found: Findings) -> None:
    """Draw the quantiles of the NEES against those of chi-square: consistent errors lie on the diagonal."""
    nees = np.sort(np.concatenate([run.nees for run in runs]))
    shares = (np.arange(len(nees)) + 0.5) / len(nees)
    rows = _some(len(nees))
    expected = chi_square_quantile(shares[rows], found.dof)
    ax.plot(expected, nees[rows], color=ESTIMATE, linewidth=1.4, label="poses")
    end = float(chi_square_quantile(0.999, found.dof))
    ax.plot([0.0, end], [0.0, end], color=TRUTH, linewidth=0.8, linestyle="--", label="consistent")
    factor = found.factor.value
    ax.plot([0.0, end], [0.0, factor * end], color=CYCLE[1], linewidth=0.9, label=f"covariance times {factor:.2f}")
    ax.set(xlim=(0.0, end), ylim=(0.0, 1.15 * max(end, factor * end)))
    ax.set(xlabel=f"quantile of chi-square with {found.dof} degrees of freedom [1]", ylabel="quantile of NEES [1]")
    ax.legend(frameon=False, loc="upper left", fontsize="small")


def _some(count: int) -> Any:
    """Indices of the points of a curve, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, _MOST_POINTS).astype(np.int64))


def _seconds(run: Errors) -> Array:
    return np.asarray((run.stamps_ns - run.stamps_ns[0]) * 1e-9)
