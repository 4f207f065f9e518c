"""Consistency of the estimators on the landmark circle: known association, the same measurements for every estimator.

The setup, in `sixthsense/testing/circle.py`, is the 2-D SLAM benchmark of the UKF-M package (Brossard, Barrau and
Bonnabel, ICRA 2020).

Errors are those of the causal estimate. `nees3` is the NEES of the pose in world coordinates, `nees3_invariant` the
NEES of the right-invariant error (both 3 if consistent), `nees_heading` the NEES of the heading (1), which is the same
in both coordinates. All are means over runs and steps, from the step at which the covariance of odometry alone has full
rank. This step is the same for every estimator, even for one that adds noise to a singular covariance.
`share_in_band` is the share of steps at which the mean of `nees3` over runs lies in its 95 % band.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from harness import Figures, arguments, check_at_least, machine, pooled, print_table, write_json

from sixthsense.core.geometry import Array
from sixthsense.evaluation.metrics import nees_band, share_in_band
from sixthsense.figures.plot import CYCLE
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.circle import STEP_S, STEPS, Track, follow, simulate

DRAWN_STEPS = 20  # steps in one point of a curve: a twelfth of a circle
WIDTHS = (1.5, 6.0, 4.0, 2.5, 1.0)  # different, because several curves coincide

# Column name, key, format, and the targets of the standard EKF and of the other estimators.
COLUMNS = (
    ("position m", "position_rmse_m", ".3f", "", ""),
    ("x ekf", "position_rmse_by_ekf", ".3f", "", "at most 0.90"),
    ("heading deg", "heading_rmse_deg", ".2f", "", ""),
    ("NEES", "nees3", ".2f", "", "2.6-3.4"),
    ("invariant", "nees3_invariant", ".2f", "", ""),
    ("of heading", "nees_heading", ".2f", "2.5-3.5", "0.9-1.1"),
    ("in band", "share_in_band", ".2f", "", ""),
    ("step ms", "step_ms", ".2f", "", ""),
)


def follow_all(run: int, estimators: Sequence[str], seed: int, steps: int = STEPS) -> dict[str, Track]:
    """The track of each estimator on the measurements of one run."""
    evidence = simulate(seed, run, steps)
    return {name: follow(name, evidence) for name in estimators}


def all_runs(
    runs: int, estimators: Sequence[str] = ESTIMATORS, seed: int = 0, jobs: int = 1, steps: int = STEPS
) -> dict[str, list[Track]]:
    """The tracks of each estimator, one per run, in the order of the runs."""
    task = partial(follow_all, estimators=estimators, seed=seed, steps=steps)
    tracks: dict[str, list[Track]] = {name: [] for name in estimators}
    for one in pooled(task, range(runs), jobs):
        for name, track in one.items():
            tracks[name].append(track)
    return tracks


def _mean_over_runs(tracks: list[Track], field: str) -> Array:
    """(K,) mean of a field; NaN at steps at which one run has no value yet."""
    return np.asarray(np.mean([getattr(track, field) for track in tracks], axis=0))


def circle_figures(tracks: dict[str, list[Track]]) -> Figures:
    """Flat keys such as `ekf_invariant.position_rmse_m`, with ratios to `ekf`, and of `isam2` to `ekf-invariant`.

    The NEES of one run is correlated over its steps, so its mean over the steps counts as one sample. `_se` is the
    standard error of the mean of these samples; it is absent for a single run.
    """
    figures: Figures = {}
    for name, runs in tracks.items():
        key = name.replace("-", "_")
        figures[f"{key}.position_rmse_m"] = _rms([track.position_m for track in runs])
        figures[f"{key}.heading_rmse_deg"] = math.degrees(_rms([track.heading for track in runs]))
        for field in ("nees3", "nees3_invariant", "nees_heading"):
            means = [float(np.nanmean(getattr(track, field))) for track in runs]
            figures[f"{key}.{field}"] = float(np.mean(means))
            if len(means) > 1:
                figures[f"{key}.{field}_se"] = float(np.std(means, ddof=1)) / math.sqrt(len(means))
        nees3 = _mean_over_runs(runs, "nees3")
        figures[f"{key}.share_in_band"] = share_in_band(nees3[~np.isnan(nees3)], nees_band(len(runs)))
        figures[f"{key}.step_ms"] = float(np.mean([track.step_ms for track in runs]))
    pairs = [(name, "ekf") for name in tracks if name != "ekf"] + [("isam2", "ekf-invariant")]
    for name, other in pairs:
        if name in tracks and other in tracks:
            key, by = name.replace("-", "_"), other.replace("-", "_")
            ratio = figures[f"{key}.position_rmse_m"] / figures[f"{by}.position_rmse_m"]
            figures[f"{key}.position_rmse_by_{by}"] = ratio
    return figures


def _rms(values: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def table(figures: Figures, estimators: Sequence[str]) -> list[list[str]]:
    """The rows of the table: column names, the estimators, and their targets."""
    rows = [["estimator", *(head for head, *_ in COLUMNS)]]
    for name in estimators:
        key = name.replace("-", "_")
        rows.append([name, *(_cell(figures, f"{key}.{column}", form) for _, column, form, _, _ in COLUMNS)])
    rows.append(["target, ekf", *(standard for *_, standard, _ in COLUMNS)])
    rows.append(["target, others", *(others for *_, others in COLUMNS)])
    return rows


def _cell(figures: Figures, key: str, form: str) -> str:
    if key not in figures:
        return ""
    error = figures.get(f"{key}_se")
    return format(figures[key], form) + ("" if error is None else f" ± {error:{form}}")


def save_figure(file: Path, tracks: dict[str, list[Track]]) -> None:
    """Draw NEES and RMSE of pose and heading over time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2, sharex=True).ravel()
    runs = len(next(iter(tracks.values())))
    for ax, field, dof in ((axes[0], "nees3", 3), (axes[1], "nees_heading", 1)):
        low, high = nees_band(runs, dof)
        ax.axhspan(low, high, color="0.88", label="95 % band of one step")
        _draw(ax, {name: _mean_over_runs(one, field) for name, one in tracks.items()})
    _draw(axes[2], {name: _rms_over_runs([track.position_m for track in one]) for name, one in tracks.items()})
    _draw(axes[3], {name: np.degrees(_rms_over_runs([track.heading for track in one])) for name, one in tracks.items()})
    labels = (
        "pose NEES, world [1]",
        "heading NEES [1]",
        "position RMSE [m]",
        "heading RMSE [°]",
    )
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        ax.set_ylim(bottom=0.0)
        ax.grid(alpha=0.3)
    for ax in axes[2:]:
        ax.set_xlabel("time [s]")
    axes[1].legend(fontsize="small")
    figure.suptitle(f"Landmark circle, {runs} runs, means over {DRAWN_STEPS} steps")
    figure.savefig(file, dpi=150)


def _rms_over_runs(errors: list[Array]) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))


def _draw(ax: Any, curves: dict[str, Array]) -> None:
    for name, values in curves.items():
        k = ESTIMATORS.index(name)
        blocks = math.ceil(len(values) / DRAWN_STEPS)
        time_s = [STEP_S * (block.mean() + 1) for block in np.array_split(np.arange(len(values)), blocks)]
        means = [block[~np.isnan(block)].mean() for block in np.array_split(values, blocks)]
        ax.plot(time_s, means, lw=WIDTHS[k], color=CYCLE[k], label=name)


def main() -> None:
    parser = arguments(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=100, metavar="N", help="number of runs (100)")
    parser.add_argument("--estimator", nargs="+", default=ESTIMATORS, choices=ESTIMATORS, help="only these")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of all runs (0)")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="write a PNG of NEES and errors over time")
    options = parser.parse_args()
    check_at_least(parser, options, runs=1, seed=0, jobs=1)
    tracks = all_runs(options.runs, options.estimator, options.seed, options.jobs)
    figures = circle_figures(tracks)
    print(machine())
    print_table(table(figures, options.estimator))
    write_json(options.json, figures)
    if options.figure is not None:
        save_figure(options.figure, tracks)


if __name__ == "__main__":
    main()
