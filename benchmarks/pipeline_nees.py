"""Consistency of the whole pipeline: closed-loop tours with unknown association, with NEES, NIS and wrong matches.

`nees3` is the NEES of the pose in world coordinates, `nees3_invariant` the NEES of the right-invariant error (both 3 if
consistent): at every keyframe after its update, from the first full-rank covariance on, the mean over the keyframes of
a run, then the mean over runs. `nees_position` (2) and `nees_heading` (1) are computed in the same way. `share_in_band`
is the share of keyframes, by their number in the run, at which the mean over runs lies in the 95 % band for that number
of runs; successive keyframes are correlated. `nees3_spread` is the standard deviation over runs of their means. A wrong
match is of another wall or point than the landmark, by the walls that the observation's returns hit
(`sixthsense.evaluation.matches`). A spanning observation is fitted to several walls. An unexplained one is of nothing
in the scene. Left out are those whose fit does not distinguish the walls concerned. `discarded_share` is the share of
all observations that the gates dropped.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from harness import Figures, arguments, machine, print_table, write_json
from tours import (
    MATCHES,
    NEES,
    InputError,
    Row,
    add_tour_options,
    check_tour_options,
    nees_of,
    over_runs,
    rows,
    seeded,
    tour,
)

from sixthsense.evaluation.metrics import nees_band, share_in_band
from sixthsense.slam.estimators import ESTIMATORS

# Column name, key, format and target.
COLUMNS = (
    ("NEES", "nees3", ".2f", "2.5-3.5"),
    ("spread", "nees3_spread", ".2f", ""),
    ("invariant", "nees3_invariant", ".2f", "2.5-3.5"),
    ("in band", "share_in_band", ".2f", ""),
    ("of position", "nees_position", ".2f", "2"),
    ("of heading", "nees_heading", ".2f", "1"),
    ("NIS/dof", "nis_per_dof", ".3f", "0.9-1.1"),
    ("wrong/1000", "wrong_per_1000", ".3f", ""),
    ("spanning/1000", "spanning_per_1000", ".2f", ""),
    ("unexplained/1000", "unexplained_per_1000", ".2f", ""),
    ("left out/1000", "left_out_per_1000", ".2f", ""),
    ("discarded", "discarded_share", ".4f", ""),
    ("ATE m, median", "ate_median_m", ".4f", ""),
    ("max", "ate_max_m", ".4f", ""),
    ("tour ended", "tour_ended", ".0f", "all"),
)


def pipeline_figures(found: Sequence[Row]) -> Figures:
    """Figures of runs that differ only in their seed."""
    figures: Figures = {"runs": len(found), "tour_ended": sum(row["outcome"] == "tour ended" for row in found)}
    for name in NEES:
        figures[name] = float(np.mean([nees_of(row, name) for row in found]))
    steps = over_runs(found, "nees3")
    figures["share_in_band"] = share_in_band(steps[~np.isnan(steps)], nees_band(len(found)))
    figures["nees3_spread"] = float(np.std([nees_of(row) for row in found], ddof=1)) if len(found) > 1 else 0.0
    figures["nis_per_dof"] = _ratio(found, "nis", "nis_dof")
    for name in MATCHES:
        figures[f"{name}_per_1000"] = 1e3 * _ratio(found, name, "observations")
    figures["discarded_share"] = float(np.mean([row["discarded_share"] for row in found]))
    ate = [row["ate_rmse_m"] for row in found]
    figures |= {"ate_median_m": float(np.median(ate)), "ate_max_m": float(np.max(ate))}
    return figures


def _ratio(found: Sequence[Row], above: str, below: str) -> float:
    return float(sum(row[above] for row in found) / max(sum(row[below] for row in found), 1))


def estimator_rows(found: Sequence[Row], estimators: Sequence[str]) -> dict[str, list[Row]]:
    """The rows of each estimator, by the prefix of the keys of its figures."""
    return {name.replace("-", "_"): [row for row in found if row["estimator"] == name] for name in estimators}


def table(figures: Figures, estimators: Sequence[str]) -> list[list[str]]:
    """The rows of the table: column names, the estimators, and their targets."""
    lines = [["estimator", *(head for head, *_ in COLUMNS)]]
    for name in estimators:
        key = name.replace("-", "_")
        lines.append([name, *(format(figures[f"{key}.{column}"], form) for _, column, form, _ in COLUMNS)])
    lines.append(["target", *(target for *_, target in COLUMNS)])
    return lines


def per_run(found: Sequence[Row]) -> list[list[str]]:
    """A row per run, to find outliers."""
    heads = [name.replace("_", " ") for name in MATCHES]
    lines = [["run", "NEES", "of position", "of heading", "NIS/dof", *heads, "discarded", "ATE m", "outcome"]]
    for row in found:
        nees = (f"{nees_of(row, name):.2f}" for name in ("nees3", "nees_position", "nees_heading"))
        nis = f"{row['nis'] / max(row['nis_dof'], 1):.3f}"
        counts = *(str(row[name]) for name in MATCHES), f"{row['discarded_share']:.4f}"
        lines.append(
            [f"{row['estimator']} {row['seed']}", *nees, nis, *counts, f"{row['ate_rmse_m']:.4f}", row["outcome"]]
        )
    return lines


def parse() -> tuple[argparse.ArgumentParser, argparse.Namespace]:
    parser = arguments(__doc__.splitlines()[0] if __doc__ else None)
    add_tour_options(parser, seeds=50)
    parser.add_argument("--estimator", nargs="+", default=["isam2", "ekf-invariant"], choices=ESTIMATORS)
    parser.add_argument("--preset", default="default", choices=("default", "worn"))
    parser.add_argument("--scene", default="apartment", metavar="SCENE", help="shipped name or file (apartment)")
    options = parser.parse_args()
    check_tour_options(parser, options)
    return parser, options


def main() -> None:
    parser, options = parse()
    both = {"features": {"landmarks": "both"}}
    try:
        configs = [
            tour(options.scene, name, options.preset, options.max_time, options.config, **both)
            for name in options.estimator
        ]
    except InputError as error:
        parser.error(str(error))
    found = rows(seeded(configs, options), options.jobs, options.rows)
    figures: Figures = {}
    for key, own in estimator_rows(found, options.estimator).items():
        figures |= {f"{key}.{name}": value for name, value in pipeline_figures(own).items()}
        figures |= {f"{key}.seed{row['seed']}.nees3": nees_of(row) for row in own}
    low, high = nees_band(options.seeds)
    print(machine())
    print(f"{options.scene}, {options.preset}: {options.seeds} tours of {options.max_time:g} s")
    print(f"95 % band of the mean over runs at one keyframe: {low:.2f}-{high:.2f}")
    print_table(per_run(found))
    print_table(table(figures, options.estimator))
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
