"""Five estimators on one recorded run: `python benchmarks/shared_evidence.py --runs 10 --figure docs/estimators.png`.

A robot drives a tour with the estimator `--driver`. Its odometry and scans are then replayed to every estimator, so
only the estimator differs. Errors are those of the causal estimate at keyframes. With `--folder RUN` the recorded run
is a folder written by `sixthsense run`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import Figures, arguments, check_at_least, machine, print_table, replay, run, write_json
from tqdm import tqdm

from sixthsense.config import Config, load_config, preset
from sixthsense.core.geometry import Array
from sixthsense.core.source import Tick
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.metrics import full_rank_from, nees_world
from sixthsense.figures.plot import CYCLE, new_figure, save
from sixthsense.record.trace import Trace
from sixthsense.running.warmup import warm_up
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.runfolder import read_run

# Column name, key in the run's metrics, and the factor to the column's unit.
COLUMNS = (
    ("ATE mm", "ate_rmse_m", 1e3),
    ("max mm", "ate_max_m", 1e3),
    ("heading mrad", "heading_rmse_rad", 1e3),
    ("NEES", "pose_nees_world_mean", 1.0),
    ("invariant", "pose_nees_invariant_mean", 1.0),
    ("NIS/dof", "nis_mean_per_dof", 1.0),
    ("landmarks", "landmarks", 1.0),
    ("landmark RMSE mm", "landmark_rmse_m", 1e3),
    ("update ms", "stage_ms_mean.update", 1.0),
    ("associate ms", "stage_ms_mean.associate", 1.0),
    ("keyframe ms p50", "scan_ms_p50", 1.0),
    ("p99", "scan_ms_p99", 1.0),
)
BIN_S = 10.0


def record(config: Config) -> Log:
    """The ticks of a simulated run."""
    ticks: list[Tick] = []
    run(config, lambda tick, _: ticks.append(tick))
    return Log(ticks)


def compare(log: Log, config: Config, estimators: Sequence[str]) -> dict[str, Trace]:
    """The trace of each estimator on one log."""
    return {name: replay(log, dataclasses.replace(config, estimator=name)).trace for name in estimators}


def over_time(trace: Trace) -> tuple[Array, Array, Array, Array]:
    """Seconds, position error (m), NEES and processing time (ms) of the keyframes; NEES is NaN without full rank."""
    t = 1e-9 * (np.array(trace.key_stamps_ns) - trace.stamps_ns[0])
    poses, truth = np.array([e.pose.array() for e in trace.key_estimates]), np.array(trace.key_truths)
    covs = np.array([e.pose_cov for e in trace.key_estimates])
    first = full_rank_from(covs)
    nees = np.full(len(t), np.nan)
    nees[first:] = nees_world(poses[first:] - truth[first:], covs[first:])
    return t, np.hypot(*(poses - truth)[:, :2].T), nees, trace.stopwatch.keyframe_ms()


def figures_of(traces: Mapping[str, Sequence[Trace]]) -> Figures:
    """Mean over the runs of each column, by keys such as `ekf_invariant.ate_rmse_m`."""
    figures: Figures = {}
    for name, runs in traces.items():
        metrics = [measure(trace) for trace in runs]
        for _, key, _ in COLUMNS:
            values = [m[key] for m in metrics if key in m]
            if values:
                figures[f"{name.replace('-', '_')}.{key}"] = float(np.mean(values))
    return figures


def draw(traces: Mapping[str, Sequence[Trace]], title: str) -> Any:
    """Draw error, NEES and processing time over time: a column per estimator, the first one's medians in grey in each.

    In bins of 10 s, the line is the median over the runs, the band is from the smallest to the largest of them.
    """
    figure = new_figure(13.0, 7.0)
    axes = figure.subplots(3, len(traces), sharex=True, sharey="row", squeeze=False)
    quantities = (
        ("position RMSE [mm]", 1e3, _rms),
        ("pose NEES, world [1]", 1.0, np.mean),
        ("keyframe [ms]", 1.0, np.median),
    )
    for row, (label, factor, reduce) in enumerate(quantities):
        axes[row, 0].set_ylabel(label)
        reference: tuple[Array, Array] | None = None
        for ax, (name, runs), color in zip(axes[row], traces.items(), CYCLE, strict=False):
            series = [over_time(trace) for trace in runs]
            middle, values = binned(
                [found[0] for found in series], [factor * found[row + 1] for found in series], reduce
            )
            median = np.median(values, axis=0)
            reference = reference or (middle, median)
            ax.fill_between(middle, values.min(axis=0), values.max(axis=0), color=color, alpha=0.25, linewidth=0)
            ax.plot(*reference, color="#999999", linewidth=1.0)
            ax.plot(middle, median, color=color, linewidth=1.4)
            ax.set_ylim(bottom=0.0)
            ax.margins(x=0.0)
            if row == 0:
                ax.set_title(name)
            if row == 1:
                ax.axhline(3.0, color="black", linewidth=0.8, linestyle=":")
            if row == 2:
                ax.set_xlabel("time [s]")
    figure.suptitle(title)
    return figure


def binned(
    times_s: Sequence[Array], values: Sequence[Array], reduce: Callable[[Array], Any], share: float = 0.5
) -> tuple[Array, Array]:
    """The middles (B,) of bins of `BIN_S` seconds, and what `reduce` makes of the finite values in each, (runs, B).

    A bin in which any run has less than `share` of the usual number of them is left out: the last one of a tour would
    show a keyframe or two.
    """
    edges = np.arange(0.0, max(float(t[-1]) for t in times_s) + 2.0 * BIN_S, BIN_S)
    finite = [(t[np.isfinite(found)], found[np.isfinite(found)]) for t, found in zip(times_s, values, strict=True)]
    counts = np.array([np.histogram(t, edges)[0] for t, _ in finite])
    full = np.flatnonzero((counts >= max(1.0, share * np.median(counts[counts > 0]))).all(axis=0))
    rows = [[reduce(found[t // BIN_S == k]) for k in full] for t, found in finite]
    return (full + 0.5) * BIN_S, np.array(rows)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--runs", type=int, default=1, metavar="N", help="recorded runs, seeds 0 to N - 1")
    parser.add_argument("--scene", default="apartment")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--seconds", type=float, default=400.0, help="simulated seconds of each tour")
    parser.add_argument("--driver", default="ekf-invariant", choices=ESTIMATORS, help="estimator that drives")
    parser.add_argument("--folder", type=Path, metavar="RUN", help="a recorded run, instead of new ones")
    parser.add_argument("--estimator", nargs="+", default=list(ESTIMATORS), choices=ESTIMATORS, metavar="NAME")
    parser.add_argument("--figure", type=Path, metavar="FILE.png")
    options = parser.parse_args()
    check_at_least(parser, options, runs=1)
    warm_up()
    traces: dict[str, list[Trace]] = {name: [] for name in options.estimator}
    for seed in tqdm(range(1 if options.folder else options.runs), unit="run", disable=None):
        if options.folder:
            config = load_config(options.folder / "config.toml")
            log: Log = read_run(options.folder, config.laser)
        else:
            config = preset(options.preset, scene=options.scene, task="tour", max_time=options.seconds, seed=seed)
            log = record(dataclasses.replace(config, estimator=options.driver))
        for name, trace in compare(log, config, options.estimator).items():
            traces[name].append(trace)
    figures = figures_of(traces)
    print(machine())
    print(f"{config.scene}, {config.preset}, {len(next(iter(traces.values())))} runs, {log.duration_s:.0f} s each")
    rows = [["estimator", *(head for head, _, _ in COLUMNS)]]
    for name in options.estimator:
        values = [(figures.get(f"{name.replace('-', '_')}.{key}"), scale) for _, key, scale in COLUMNS]
        rows.append([name, *("" if value is None else f"{scale * value:.3g}" for value, scale in values)])
    print_table(rows)
    write_json(options.json, figures)
    if options.figure:
        count = len(next(iter(traces.values())))
        title = f"{len(traces)} estimators, the same measurements: {config.scene} tour, {count} run{'s' * (count > 1)}"
        save(draw(traces, title), options.figure)


if __name__ == "__main__":
    main()
