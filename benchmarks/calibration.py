"""What calibration is worth: worlds that are noisier than assumed, each toured before and after measuring its noise."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from harness import Figures, arguments, machine, print_table, write_json

from sixthsense.config import Config, merge, preset
from sixthsense.evaluation.calibrate import SAMPLES, calibrate
from sixthsense.loop import run, warm_up

SCENE = "apartment"
TOUR_S = 200.0
MORE = 3.0  # so many times the noise that is assumed

_MOTION, _LASER = preset().assumed.motion, preset().assumed.laser
_TURN = {"motion": {"turn_rate": MORE * _MOTION.turn_rate}}
_SLIP = {
    "motion": {
        "slip_heading_per_sqrt_m": MORE * _MOTION.slip_heading_per_sqrt_m,
        "slip_heading_per_sqrt_rad": MORE * _MOTION.slip_heading_per_sqrt_rad,
    }
}
_RANGE = {"laser": {"range_m": MORE * _LASER.range_m}}

# Name: preset, and what the world does besides. The first is the control: what is assumed is true.
WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    "as_assumed": ("default", {}),
    "worn": ("worn", {}),
    "turn_rate_x3": ("default", _TURN),
    "heading_slip_x3": ("default", _SLIP),
    "laser_x3": ("default", _RANGE),
    "all_x3": ("default", {"motion": _TURN["motion"] | _SLIP["motion"], **_RANGE}),
}

# Column's head, key in the run's metrics.
COLUMNS = (
    ("ATE m", "ate_rmse_m"),
    ("pose NEES", "pose_nees_world_mean"),
    ("NIS/dof", "nis_mean_per_dof"),
)
STEPS = ("before", "after")


def world_config(name: str, max_time: float = TOUR_S) -> Config:
    """A tour in the world of that name, with the default's assumptions."""
    base, changes = WORLDS[name]
    return merge(preset(base, scene=SCENE, task="tour", max_time=max_time), {"world": changes})


def world_figures(name: str, seeds: int, max_time: float = TOUR_S, samples: int = SAMPLES) -> Figures:
    """Medians over the seeds under `world.step.key_median`, and how many runs ended before their time.

    Each seed measures for itself and tours twice. What a run that ended early has measured is counted like the others.
    """
    rows: dict[str, list[dict[str, Any]]] = {step: [] for step in STEPS}
    for seed in range(seeds):
        before = dataclasses.replace(world_config(name, max_time), seed=seed)
        after = dataclasses.replace(before, assumed=calibrate(before, samples).assumed)
        for step, config in zip(STEPS, (before, after), strict=True):
            rows[step].append(run(config).metrics)
    figures: Figures = {}
    for step, metrics in rows.items():
        figures[f"{name}.{step}.ended_early"] = sum(one["outcome"] != "tour ended" for one in metrics)
        for _, key in COLUMNS:
            values = [one.get(key, math.nan) for one in metrics]
            if not np.isnan(values).all():
                figures[f"{name}.{step}.{key}_median"] = float(np.nanmedian(values))
    return figures


def row(name: str, figures: Figures) -> list[str]:
    """A line of the table: each figure before -> after."""
    cells = [
        " -> ".join(_cell(figures.get(f"{name}.{step}.{key}_median"), ".3g") for step in STEPS) for _, key in COLUMNS
    ]
    return [name, *cells, " -> ".join(_cell(figures[f"{name}.{step}.ended_early"], ".0f") for step in STEPS)]


def _cell(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=6, metavar="N", help="so many seeds per world")
    options = parser.parse_args()
    if options.seeds < 1:
        parser.error(f"--seeds: found {options.seeds}, allowed: at least 1")
    warm_up()
    figures: Figures = {}
    rows = [["world", *(column[0] for column in COLUMNS), "ended early"]]
    for name in WORLDS:
        figures |= world_figures(name, options.seeds)
        rows.append(row(name, figures))
    print(machine())
    print_table(rows)
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
