"""Explorations among people: outcome, coverage, touches, NEES and time, against the same seeds without people.

    python benchmarks/walkers.py                          # the table, about 20 minutes on two processors
    python benchmarks/walkers.py --scenes apartment --walkers 0 3 --seeds 1

A stray obstacle is a cell of the final map farther than 0.15 m from every true wall. A stray landmark is as far. NEES
is pooled over the keyframes of a row's runs; times are simulated seconds, as a share of those without people.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np
from asked import warm
from harness import Figures, arguments, check_at_least, finish, pooled, run

from sixthsense.config import Config, preset
from sixthsense.core.geometry import Array, point_segment_distance
from sixthsense.evaluation import metrics
from sixthsense.record.trace import Trace

FRONT_ENDS = {"ekf-invariant": "landmarks", "isam2": "scan-matching"}
STRAY_M = 0.15
Row = dict[str, Any]


def strays(points: Array, walls: Array) -> int:
    """How many of points (N, 2) are far from every wall."""
    return sum(float(point_segment_distance(point, walls).min()) > STRAY_M for point in points)


def make_row(config: Config) -> Row:
    """Explore, and look at what people have left in the map."""
    began = time.process_time()
    found = run(config)
    spent_s = time.process_time() - began
    trace, values = found.trace, found.metrics
    assert trace.scene is not None and trace.grid is not None
    walls, cell_m = trace.scene.walls, config.grid.cell_m
    cells = np.argwhere(trace.grid.obstacles)
    places = np.array(trace.grid.origin) + cell_m * (cells[:, ::-1] + 0.5)
    extents = [trace.records[i].extent.mean(axis=0) for i in trace.final.ids[trace.final.walls].tolist()]
    marks = np.concatenate([trace.final.landmarks[~trace.final.walls], np.array(extents).reshape(-1, 2)])
    row = {
        "scene": config.scene, "estimator": config.estimator, "walkers": config.world.walkers, "seed": config.seed,
        "outcome": values["outcome"], "coverage": values["coverage"], "by_robot": values.get("touches_by_robot", 0),
        "by_walkers": values.get("touches_by_walkers", 0), "nees": _nees(trace), "sim_s": values["sim_time_s"],
        "travel_m": values["path_length_m"], "stray_share": strays(places, walls) / np.count_nonzero(trace.grid.seen),
        "stray_landmarks": strays(marks, walls), "ate_m": values["ate_rmse_m"], "processor_s": spent_s,
    }  # fmt: skip
    print(json.dumps({key: value for key, value in row.items() if key != "nees"}), file=sys.stderr, flush=True)
    return row


def _nees(trace: Trace) -> list[float]:
    """NEES of the pose after each update, from the first full-rank covariance on."""
    covs = np.array([estimate.pose_cov for estimate in trace.key_estimates])
    errors = np.array([estimate.pose.array() for estimate in trace.key_estimates]) - np.array(trace.key_truths)
    first = metrics.full_rank_from(covs)
    return [float(value) for value in metrics.nees_world(errors[first:], covs[first:])]


def summary(found: list[Row], without: list[Row]) -> Figures:
    """Figures of the runs of one row of the table; `without` are those without people."""
    nees = float(np.mean(np.concatenate([row["nees"] for row in found])))
    alone = float(np.mean(np.concatenate([row["nees"] for row in without]))) if without else np.nan
    sim_s = float(np.mean([row["sim_s"] for row in found]))
    return {
        "runs": len(found), "explored": sum(row["outcome"] == "explored" for row in found),
        "coverage": min(row["coverage"] for row in found), "by_robot": sum(row["by_robot"] for row in found),
        "by_walkers": sum(row["by_walkers"] for row in found), "nees": nees, "nees_ratio": nees / alone,
        "sim_s": sim_s, "time_ratio": sim_s / float(np.mean([row["sim_s"] for row in without])) if without else np.nan,
        "stray_percent": 100.0 * float(np.mean([row["stray_share"] for row in found])),
        "stray_landmarks": sum(row["stray_landmarks"] for row in found),
        "ate_mm": 1e3 * float(np.mean([row["ate_m"] for row in found])),
        "times_real": sum(row["sim_s"] for row in found) / sum(row["processor_s"] for row in found),
    }  # fmt: skip


COLUMNS = (
    ("explored", "explored", ".0f"), ("coverage, least", "coverage", ".4f"), ("robot's fault", "by_robot", ".0f"),
    ("walkers'", "by_walkers", ".0f"), ("NEES", "nees", ".2f"), ("over without", "nees_ratio", ".2f"),
    ("simulated s", "sim_s", ".0f"), ("over without", "time_ratio", ".2f"), ("stray %", "stray_percent", ".3f"),
    ("stray landmarks", "stray_landmarks", ".0f"), ("ATE mm", "ate_mm", ".1f"), ("x real", "times_real", ".0f"),
)  # fmt: skip


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--scenes", nargs="+", default=["apartment", "office"])
    parser.add_argument("--estimators", nargs="+", default=list(FRONT_ENDS), choices=list(FRONT_ENDS))
    parser.add_argument("--walkers", nargs="+", type=int, default=[0, 3, 10], metavar="N", help="people (0 3 10)")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds 0 to N - 1 (5)")
    parser.add_argument("--max-time", type=float, default=3000.0, metavar="S", help="simulated seconds of a run (3000)")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1, jobs=1)
    kinds = [(s, e, n) for s in options.scenes for e in options.estimators for n in sorted(options.walkers)]
    configs = [
        preset(scene=s, estimator=e, front_end=FRONT_ENDS[e], max_time=options.max_time, world={"walkers": n})
        for s, e, n in kinds
    ]
    due = [config.replaced(seed=seed) for config in configs for seed in range(options.seeds)]
    rows = pooled(make_row, due, options.jobs, warm)
    of = {kind: rows[k * options.seeds : (k + 1) * options.seeds] for k, kind in enumerate(kinds)}
    lines = [["scene", "estimator", "walkers", "runs", *(head for head, *_ in COLUMNS)]]
    for (s, e, n), found in of.items():
        values = summary(found, of.get((s, e, 0), []))
        shown = [format(values[key], form) for _, key, form in COLUMNS]
        lines.append([s, e, str(n), f"{values['runs']:.0f}", *shown])
    finish(options, "walkers", lines, text=2)
    return 0


if __name__ == "__main__":
    sys.exit(main())
