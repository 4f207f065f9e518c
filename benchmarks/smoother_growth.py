"""Processing time of the smoother as its graph grows: `python benchmarks/smoother_growth.py --figure growth.png`.

A tour of the apartment with 6,000 scans and `isam2`: the processing time of every keyframe, by tenths of the run. Other
places, front ends and estimators: `--scene campus --seconds 3600`, `--front-end scan-matching --seconds 2400`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from harness import Figures, arguments, machine, print_table, run, write_json

from sixthsense.config import preset
from sixthsense.figures.plot import ESTIMATE, LANDMARK, new_figure, save
from sixthsense.record.stopwatch import STAGES
from sixthsense.running.warmup import warm_up
from sixthsense.slam.estimators import ESTIMATORS

BUDGET_MS = 16.7
TENTHS = 10


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--estimator", default="isam2", choices=ESTIMATORS)
    parser.add_argument("--scene", default="apartment")
    parser.add_argument("--front-end", default="landmarks", choices=("landmarks", "scan-matching"))
    parser.add_argument("--landmarks", default="both", choices=("corners", "walls", "both"))
    parser.add_argument("--seconds", type=float, default=600.0, help="simulated, with ten scans per second (600)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path, metavar="FILE.png")
    options = parser.parse_args()
    warm_up()
    config = preset(
        scene=options.scene, task="tour", estimator=options.estimator, seed=options.seed, max_time=options.seconds,
        front_end=options.front_end, features={"landmarks": options.landmarks},
    )  # fmt: skip
    made = run(config)
    trace = made.trace
    ms = trace.stopwatch.keyframe_ms()
    print(machine())
    print(f"{len(trace.stamps_ns)} scans, {len(ms)} keyframes, {len(trace.records)} landmarks, {trace.outcome}")
    parts = np.array_split(np.arange(len(ms)), TENTHS)
    rows = [["keyframes", "p50 ms", "p99 ms", "max ms", *STAGES[1:]]]
    for part in parts:
        means = [np.mean([trace.stopwatch.rows[k].get(stage, 0.0) for k in part]) for stage in STAGES[1:]]
        figures = [*np.percentile(ms[part], [50, 99]), ms[part].max(), *means]
        rows.append([f"{part[0]}-{part[-1]}", *(f"{value:.2f}" for value in figures)])
    print_table(rows)
    figures: Figures = {
        "scans": len(trace.stamps_ns),
        "keyframes": len(ms),
        "scan_ms_p50": float(np.percentile(ms, 50)),
        "scan_ms_p99": float(np.percentile(ms, 99)),
        "scan_ms_max": float(ms.max()),
        "last_over_first_tenth": float(np.median(ms[parts[-1]]) / np.median(ms[parts[0]])),
        "last_over_second_tenth": float(np.median(ms[parts[-1]]) / np.median(ms[parts[1]])),
        "ate_rmse_m": made.metrics["ate_rmse_m"],
        "pose_nees_world_mean": made.metrics["pose_nees_world_mean"],
        "realtime_factor": made.metrics["realtime_factor"],
    }
    print_table([["figure", "measured"], *([key, f"{value:.4g}"] for key, value in figures.items())])
    write_json(options.json, figures)
    if options.figure:
        figure = new_figure(11.0, 4.0)
        ax = figure.add_subplot()
        ax.plot(ms, ".", markersize=2, color=ESTIMATE, label="keyframe")
        ax.plot(
            [p.mean() for p in parts], [np.median(ms[p]) for p in parts], color=LANDMARK, label="median of each tenth"
        )
        ax.axhline(BUDGET_MS, color="#999999", linestyle="--", label=f"{BUDGET_MS} ms")
        ax.set_xlabel("keyframe")
        ax.set_ylabel("processing time [ms]")
        ax.set_ylim(0.0)
        ax.legend(loc="upper left", ncols=3)
        ax.set_title(f"{options.estimator}: processing time per keyframe as the graph grows")
        save(figure, options.figure)


if __name__ == "__main__":
    main()
