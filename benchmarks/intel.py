"""The log of the Intel Research Lab: the trajectory and raw odometry against the hand-checked relations."""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from pathlib import Path

import numpy as np
from harness import Figures, arguments, check_at_least, machine, print_table, replay, write_json

from sixthsense.config import Config, preset
from sixthsense.evaluation import metrics
from sixthsense.running.warmup import warm_up
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.sources.logs import open_log
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.relations import Relations, read_relations
from sixthsense.sources.replay_input import of_log

# The wheels of this robot, from a regression of the filter's motion on the odometry's, iterated to convergence, without
# the relations; the noise that is left was chosen on the relations with corners. No preset knows them.
CALIBRATED = {
    "wheel_scale_error": -0.02,
    "drift_rad_per_m": 0.0595,
    "motion": {
        "slip_position_per_sqrt_m": 0.02,
        "slip_position_per_sqrt_rad": 2e-3,
        "slip_heading_per_sqrt_m": 0.035,
        "slip_heading_per_sqrt_rad": 0.03,
    },
}
ERRORS = ("relations_trans_m_mean", "relations_trans_m_std", "relations_rot_deg_mean", "relations_rot_deg_std")


def replay_figures(log: Log, relations: Relations, config: Config, seeds: int) -> Figures:
    """Errors for each seed, their medians, errors of odometry, and speed. The seed only affects RANSAC."""
    figures: Figures = {}
    speeds: list[float] = []
    for seed in range(seeds):
        made = replay(Log(log.ticks), dataclasses.replace(config, seed=seed), relations)
        trace, result = made.trace, made.metrics
        figures |= {f"seed{seed}.{key}": result[key] for key in ERRORS}
        speeds.append(result["realtime_factor"])
        if seed == 0:
            stamps = np.array(trace.log_stamps_s)
            translation, angle = metrics.relations_error(
                stamps, np.array(trace.odometry), relations.stamps, relations.poses
            )
            turn = np.degrees(angle)
            errors = (translation.mean(), translation.std(), turn.mean(), turn.std())
            figures |= {f"odometry.{key}": float(error) for key, error in zip(ERRORS, errors, strict=True)}
    for key in ERRORS:
        figures[f"{key}_median"] = float(np.median([figures[f"seed{seed}.{key}"] for seed in range(seeds)]))
    figures["realtime_factor_median"] = float(np.median(speeds))
    return figures


def rows(figures: Figures, seeds: int) -> list[list[str]]:
    """The table: a row per seed, their median, and raw odometry."""

    def line(name: str, keys: list[str]) -> list[str]:
        translation, translation_std, rotation, rotation_std = (figures[key] for key in keys)
        return [name, f"{translation:.3f} ± {translation_std:.3f}", f"{rotation:.2f} ± {rotation_std:.2f}"]

    lines = [["trajectory", "translation, m", "rotation, degrees"]]
    lines += [line(f"seed {seed}", [f"seed{seed}.{key}" for key in ERRORS]) for seed in range(seeds)]
    lines.append(line("median", [f"{key}_median" for key in ERRORS]))
    lines.append(line("raw odometry", [f"odometry.{key}" for key in ERRORS]))
    return lines


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds 0 to N - 1 (5)")
    parser.add_argument("--estimator", choices=ESTIMATORS, default="isam2", help="(isam2)")
    parser.add_argument("--uncalibrated", action="store_true", help="wheels and noise of the preset log alone")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1)
    folder = Path(os.environ.get("SIXTHSENSE_DATA", "")) / "intel"
    files = folder / "intel.clf.bz2", folder / "intel.relations"
    if "SIXTHSENSE_DATA" not in os.environ or not all(file.is_file() for file in files):
        print("intel.py: SIXTHSENSE_DATA must be a folder with intel/intel.clf.bz2 and .relations", file=sys.stderr)
        return 2
    warm_up()
    assumed = {} if options.uncalibrated else CALIBRATED
    config = preset("log", estimator=options.estimator, front_end="landmarks", assumed=assumed)
    began = time.perf_counter()
    log, relations = open_log(files[0]), read_relations(files[1])
    config = of_log(config, log)
    reading_s = time.perf_counter() - began
    figures = replay_figures(log, relations, config, options.seeds)
    figures |= {"log_s": log.duration_s, "reading_s": reading_s}
    print(machine())
    print_table(rows(figures, options.seeds))
    speed = figures["realtime_factor_median"]
    print(f"log of {log.duration_s:.0f} s, {len(log.scans)} scans: read in {reading_s:.1f} s, ", end="")
    print(f"replayed in {log.duration_s / speed:.1f} s, {speed:.0f} times real time")
    write_json(options.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
