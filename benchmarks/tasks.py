"""Outcomes and errors of closed-loop tasks in the shipped scenes, over seeds."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from harness import Figures, arguments, check_at_least, machine, print_table, run, write_json

from sixthsense.config import preset
from sixthsense.running.warmup import warm_up


@dataclass(frozen=True)
class Setting:
    """Runs that differ only in their seed."""

    scene: str
    task: Literal["goal", "tour"]
    preset: str
    seeds: int
    """number of seeds, from 0"""
    max_time: float = 600.0
    """simulated seconds"""

    @property
    def name(self) -> str:
        """The prefix of the keys of its figures."""
        return f"{self.scene}.{self.task}.{self.preset}"


SETTINGS = (
    Setting("apartment", "goal", "default", 20),
    Setting("rectangle", "goal", "default", 20),
    Setting("office", "goal", "default", 20),
    Setting("apartment", "goal", "worn", 10),
    Setting("apartment", "tour", "worn", 10, 300.0),
    Setting("block", "goal", "default", 10),
    Setting("block", "goal", "worn", 10),
)

# Column name, key in the run's metrics, suffix of the figure's key, and the reduction over runs.
COLUMNS: tuple[tuple[str, str, str, Callable[[Sequence[float]], Any]], ...] = (
    ("collisions", "collisions", "", np.sum),
    ("ATE m, median", "ate_rmse_m", "_median", np.median),
    ("max", "ate_rmse_m", "_max", np.max),
    ("dead reckoning", "dead_reckoning_ate_rmse_m", "_median", np.median),
    ("x real time", "realtime_factor", "_median", np.median),
    ("p99 ms, max", "scan_ms_p99", "_max", np.max),
    ("NEES", "pose_nees_world_mean", "_mean", np.mean),
    ("NIS/dof", "nis_mean_per_dof", "_mean", np.mean),
    ("coverage", "coverage", "_median", np.median),
    ("true m to goal, max", "goal_error_m", "_max", np.max),
)


def setting_figures(setting: Setting) -> Figures:
    """Counts of outcomes and the columns of the table over a setting's seeds, without what no run measured."""
    config = preset(setting.preset)
    config = dataclasses.replace(config, scene=setting.scene, task=setting.task, max_time=setting.max_time)
    results = [run(dataclasses.replace(config, seed=seed)).metrics for seed in range(setting.seeds)]
    outcomes = Counter(result["outcome"].replace(" ", "_") for result in results)
    figures: Figures = {f"{setting.name}.outcome.{outcome}": count for outcome, count in outcomes.most_common()}
    for _, key, suffix, reduce in COLUMNS:
        values = [result[key] for result in results if key in result]
        if values:
            figures[f"{setting.name}.{key}{suffix}"] = reduce(values).item()
    return figures


def row(setting: Setting, figures: Figures) -> list[str]:
    """A row of the table."""
    start = f"{setting.name}.outcome."
    outcomes = [f"{int(n)} {key.removeprefix(start)}" for key, n in figures.items() if key.startswith(start)]
    values = [figures.get(f"{setting.name}.{key}{suffix}") for _, key, suffix, _ in COLUMNS]
    cells = ["" if value is None else f"{value:.3g}" for value in values]
    return [setting.name, ", ".join(outcomes).replace("_", " "), *cells]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, metavar="N", help="upper bound of the seeds per setting")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1)
    warm_up()
    figures: Figures = {}
    rows = [["setting", "outcomes", *(column[0] for column in COLUMNS)]]
    for setting in SETTINGS:
        capped = dataclasses.replace(setting, seeds=min(setting.seeds, options.seeds or setting.seeds))
        found = setting_figures(capped)
        figures |= found
        rows.append(row(capped, found))
    print(machine())
    print_table(rows)
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
