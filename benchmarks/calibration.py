"""The effect of calibration: tours of worlds noisier than assumed, before and after their noise was calibrated."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from harness import Figures, arguments, check_at_least, machine, print_table, run, write_json

from sixthsense.config import Config, merge, preset
from sixthsense.evaluation.calibrate import SAMPLES, calibrate
from sixthsense.running.warmup import warm_up

SCENE = "apartment"
TOUR_S = 200.0
NOISE_FACTOR = 3.0  # of the world's noise to the assumed noise

_MOTION, _LASER = preset().assumed.motion, preset().assumed.laser
_TURN = {"motion": {"turn_rate": NOISE_FACTOR * _MOTION.turn_rate}}
_SLIP = {
    "motion": {
        "slip_heading_per_sqrt_m": NOISE_FACTOR * _MOTION.slip_heading_per_sqrt_m,
        "slip_heading_per_sqrt_rad": NOISE_FACTOR * _MOTION.slip_heading_per_sqrt_rad,
    }
}
_RANGE = {"laser": {"range_m": NOISE_FACTOR * _LASER.range_m}}

# Name: preset and changes of the world. The first is the control: the assumed noise is correct.
WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    "as_assumed": ("default", {}),
    "worn": ("worn", {}),
    "turn_rate_x3": ("default", _TURN),
    "heading_slip_x3": ("default", _SLIP),
    "laser_x3": ("default", _RANGE),
    "all_x3": ("default", {"motion": _TURN["motion"] | _SLIP["motion"], **_RANGE}),
}

# Column name and key in the run's metrics.
COLUMNS = (
    ("ATE m", "ate_rmse_m"),
    ("pose NEES", "pose_nees_world_mean"),
    ("NIS/dof", "nis_mean_per_dof"),
)
STEPS = ("before", "after")


def world_config(name: str, max_time: float = TOUR_S) -> Config:
    """A tour in the world `name` with the assumptions of the default preset."""
    base, changes = WORLDS[name]
    return merge(preset(base, scene=SCENE, task="tour", max_time=max_time), {"world": changes})


def world_figures(name: str, seeds: int, max_time: float = TOUR_S, samples: int = SAMPLES) -> Figures:
    """Medians over the seeds with keys `world.step.key_median`, and the number of runs that ended early.

    Each seed calibrates on its own and tours twice. Runs that ended early count like the others.
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
    """A row of the table: each figure before -> after."""
    cells = [
        " -> ".join(_cell(figures.get(f"{name}.{step}.{key}_median"), ".3g") for step in STEPS) for _, key in COLUMNS
    ]
    return [name, *cells, " -> ".join(_cell(figures[f"{name}.{step}.ended_early"], ".0f") for step in STEPS)]


def _cell(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=6, metavar="N", help="seeds per world (6)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1)
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
