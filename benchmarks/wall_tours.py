"""Walls and corners as landmarks where corners are rare: tours of `block` and `loop` with all estimators."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from harness import Figures, arguments, machine, print_table, write_json
from tours import InputError, Row, add_tour_options, check_tour_options, nees_of, rows, seeded, tour

from sixthsense.slam.estimators import ESTIMATORS

TARGETS = {
    ("block", "default"): (0.10, 0.20),
    ("block", "worn"): (0.10, 0.20),
    ("loop", "default"): (0.15, None),
    ("loop", "worn"): (0.50, None),
}
"""upper bounds of ate_rmse_m with all kinds of landmarks: median and maximum over runs"""

Key = tuple[str, str, str, str]
"""scene, preset, landmarks, estimator"""


def tour_figures(found: Sequence[Row]) -> Figures:
    """Figures of runs that differ only in their seed."""
    ate = [row["ate_rmse_m"] for row in found]
    nees = [nees_of(row) for row in found]
    return {
        "runs": len(found),
        "tour_ended": sum(row["outcome"] == "tour ended" for row in found),
        "ate_median_m": float(np.median(ate)),
        "ate_max_m": float(np.max(ate)),
        "nees3": float(np.mean(nees)),
        "nees3_max": float(np.max(nees)),
        "wrong_per_1000": 1e3 * sum(row["wrong"] for row in found) / max(sum(row["observations"] for row in found), 1),
    }


def line(key: Key, figures: Figures) -> list[str]:
    """A row of the table."""
    scene, name, landmarks, _ = key
    bounds = TARGETS.get((scene, name), (None, None)) if landmarks == "both" else (None, None)
    median, most = ("" if limit is None else f"{limit:.2f}" for limit in bounds)
    forms = (("ate_median_m", ".4f"), ("ate_max_m", ".4f"), ("nees3", ".2f"), ("nees3_max", ".1f"))
    cells = [format(figures[column], form) for column, form in (*forms, ("wrong_per_1000", ".3f"))]
    ended = f"{figures['tour_ended']:.0f}/{figures['runs']:.0f}"
    return [" ".join(key), ended, cells[0], median, cells[1], most, *cells[2:]]


def main() -> None:
    parser = arguments(__doc__)
    add_tour_options(parser, seeds=20)
    parser.add_argument("--estimator", nargs="+", default=list(ESTIMATORS), choices=ESTIMATORS)
    parser.add_argument("--preset", nargs="+", default=["default", "worn"], choices=("default", "worn"))
    parser.add_argument("--scene", nargs="+", default=["block", "loop"], metavar="SCENE", help="(block loop)")
    parser.add_argument("--landmarks", nargs="+", default=["both", "corners"], choices=("both", "corners", "walls"))
    options = parser.parse_args()
    check_tour_options(parser, options)
    keys: list[Key] = list(itertools.product(options.scene, options.preset, options.landmarks, options.estimator))
    try:
        configs = [
            tour(scene, estimator, name, options.max_time, options.config, features={"landmarks": landmarks})
            for scene, name, landmarks, estimator in keys
        ]
    except InputError as error:
        parser.error(str(error))
    found = rows(seeded(configs, options), options.jobs, options.rows)
    figures: Figures = {}
    lines = [["tour", "ended", "ATE m, median", "target", "max", "target", "NEES", "max", "wrong/1000"]]
    for k, key in enumerate(keys):
        own = tour_figures(found[k :: len(keys)])
        prefix = ".".join(key).replace("-", "_")
        figures |= {f"{prefix}.{name}": value for name, value in own.items()}
        lines.append(line(key, own))
    print(machine())
    print_table(lines)
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
