"""Consistency of the estimators past short walls, whose distances are best known at their middles; matches are known.

    python benchmarks/short_walls.py --runs 20

NEES of the pose (3 if consistent), the mean over runs and over the last fifth of the way, with its standard error over
runs; error along the way at its end.
"""

from __future__ import annotations

import math

import numpy as np
from harness import Figures, arguments, check_at_least, machine, print_table, write_json

from sixthsense.evaluation.metrics import nees_world
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.short_walls import drive_past_short_walls

WAYS = ((30.0, 0.005), (30.0, 0.03), (100.0, 0.005), (100.0, 0.03))
"""length, metres, and sigma of the direction of an observation, rad"""


def figures_of(name: str, way_m: float, direction_rad: float, runs: int) -> Figures:
    """NEES and error of an estimator on one way."""
    nees, ends = [], []
    for seed in range(runs):
        errors, covs = drive_past_short_walls(name, seed, way_m, direction_rad)
        nees.append(nees_world(errors, covs)[-max(1, len(errors) // 5) :].mean())
        ends.append(errors[-1, 0])
    spread = float(np.std(nees, ddof=1)) / math.sqrt(runs)
    return {"nees": float(np.mean(nees)), "spread": spread, "along_mm": 1e3 * float(np.sqrt(np.mean(np.square(ends))))}


def main() -> None:
    """Measure all estimators on all ways."""
    parser = arguments(__doc__)
    parser.add_argument("--runs", type=int, default=20, metavar="N", help="runs, at least 2, seeds from 0 on (20)")
    parser.add_argument("--estimator", nargs="+", choices=ESTIMATORS, default=list(ESTIMATORS))
    args = parser.parse_args()
    check_at_least(parser, args, runs=2)
    print(machine())
    figures: Figures = {}
    rows = []
    for way_m, direction_rad in WAYS:
        for name in args.estimator:
            found = figures_of(name, way_m, direction_rad, args.runs)
            figures |= {f"way_{way_m:.0f}_m_{1e3 * direction_rad:.0f}_mrad_{name}_{key}": v for key, v in found.items()}
            rows.append(
                [
                    f"{way_m:.0f} m, {direction_rad:g} rad",
                    name,
                    f"{found['nees']:.2f} ± {found['spread']:.2f}",
                    f"{found['along_mm']:.1f}",
                ]
            )
    print_table([("way, sigma of direction", "estimator", "NEES (3)", "error along mm"), *rows])
    write_json(args.json, figures)


if __name__ == "__main__":
    main()
