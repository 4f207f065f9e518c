"""The effect of de-skewing: tours of the apartment with a scanner whose sweep takes 0.1 s, over seeds.

The map error is the root mean square, over the obstacle cells of the final map, of the distance from a cell's centre to
the nearest true wall. It is not zero for a perfect map: the centre of a correct cell lies up to half a cell off.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from harness import Figures, arguments, check_at_least, machine, print_table, run, write_json

from sixthsense.config import Config, merge, preset
from sixthsense.core.geometry import point_segment_distance
from sixthsense.record.trace import Trace
from sixthsense.running.warmup import warm_up

SWEEP_S = 0.1

SETTINGS: dict[str, dict[str, Any]] = {
    "instant": {},
    "deskewed": {"laser": {"sweep_s": SWEEP_S}},
    "skewed": {"laser": {"sweep_s": SWEEP_S}, "features": {"deskew": False}},
}

# Column name and key of the figure.
COLUMNS = (
    ("ATE mm, median", "ate_rmse_mm_median"),
    ("max", "ate_rmse_mm_max"),
    ("NEES", "pose_nees_world_mean"),
    ("landmarks mm", "landmark_rmse_mm_median"),
    ("map mm", "map_rmse_mm_median"),
    ("x real time", "realtime_factor_median"),
)


def map_rmse_m(trace: Trace) -> float:
    """RMS distance of the obstacle cells' centres from the nearest true wall, metres."""
    assert trace.grid is not None and trace.scene is not None
    rows, cols = np.nonzero(trace.grid.obstacles)
    centres = np.column_stack([cols + 0.5, rows + 0.5]) * trace.config.grid.cell_m + trace.grid.origin
    gaps = [float(point_segment_distance(centre, trace.scene.walls).min()) for centre in centres]
    return float(np.sqrt(np.mean(np.square(gaps)))) if gaps else 0.0


def setting_figures(name: str, base: Config, changes: Mapping[str, Any], seeds: int) -> Figures:
    """Figures of one setting over its seeds, with keys `name.figure`."""
    config = merge(base, changes)
    rows = []
    for seed in range(seeds):
        made = run(dataclasses.replace(config, seed=seed))
        rows.append(made.metrics | {"map_rmse_m": map_rmse_m(made.trace)})

    def values(key: str) -> list[float]:
        return [row[key] for row in rows if key in row]

    return {
        f"{name}.ate_rmse_mm_median": 1e3 * float(np.median(values("ate_rmse_m"))),
        f"{name}.ate_rmse_mm_max": 1e3 * max(values("ate_rmse_m")),
        f"{name}.pose_nees_world_mean": float(np.mean(values("pose_nees_world_mean"))),
        f"{name}.landmark_rmse_mm_median": 1e3 * float(np.median(values("landmark_rmse_m") or [0.0])),
        f"{name}.map_rmse_mm_median": 1e3 * float(np.median(values("map_rmse_m"))),
        f"{name}.realtime_factor_median": float(np.median(values("realtime_factor"))),
        f"{name}.collisions": sum(values("collisions")),
    }


def main() -> None:
    parser = arguments((__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds per setting and estimator (5)")
    parser.add_argument("--estimators", nargs="+", default=["ekf-invariant", "isam2"], metavar="NAME")
    parser.add_argument("--max-time", type=float, default=120.0, metavar="S", help="simulated seconds of each run")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1)
    warm_up()
    figures: Figures = {}
    rows = [["estimator and scans", *(head for head, _ in COLUMNS)]]
    for estimator in options.estimators:
        base = preset(
            scene="apartment",
            task="tour",
            estimator=estimator,
            max_time=options.max_time,
            features={"landmarks": "both"},
        )
        for setting, changes in SETTINGS.items():
            name = f"{estimator.replace('-', '_')}.{setting}"
            figures |= setting_figures(name, base, changes, options.seeds)
            rows.append([name, *(f"{figures[f'{name}.{key}']:.3g}" for _, key in COLUMNS)])
    print(machine())
    print_table(rows)
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
