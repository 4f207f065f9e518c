"""Explorations of shipped scenes and of plans that others drew: one table of asked, measured and met; 25 minutes.

    SIXTHSENSE_DATA=FOLDER python benchmarks/explored_worlds.py --keep             # interrupted, the same resumes
    python benchmarks/explored_worlds.py --rows perfect                            # runs whose key begins so
    python benchmarks/explored_worlds.py --world PLAN.yaml X Y THETA --seeds 2     # explorations of other places

- `perfect`: odometry without errors, from two places each, the begins of two tours of `worlds.py`. The travel is
  compared with that of a robot which drives to the nearest frontier (`nearest_frontier.py`).
- `large`: the default configuration in large buildings. Navigation is what views, plans and paths take of a keyframe,
  times real time is of the whole run, both by processor time.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from asked import Case, Figures, Found, Line, line, measure, selected
from harness import (
    PACKAGE,
    arguments,
    check_at_least,
    code_commit,
    data_path,
    finish,
    pooled,
    print_table,
    run_by_processor,
)
from nearest_frontier import nearest_frontier_travel
from worlds import maps_at_hand, world

from sixthsense.config import Config, preset
from sixthsense.config.errors import InputError
from sixthsense.running.warmup import warm_up
from sixthsense.sources.mission import mission
from sixthsense.sources.scene import load_scene

CODE = (*PACKAGE, *(f"benchmarks/{name}.py" for name in (
    "asked", "explored_worlds", "generated_worlds", "harness", "nearest_frontier", "worlds")))  # fmt: skip
"""what the figures depend on"""

FIRST_SEED = 1000
SHIPPED = ("rectangle", "block", "apartment", "office", "loop")
LARGE = {
    "willow": (28.85, 26.65, 0.0), "kth_50037765_PLAN3": (130.0, 27.8, 0.0),
    "stata": (-20.15, 9.84, 0.0), "building_31": (-7.575, 4.675, 0.0),
}  # fmt: skip
"""plans of large buildings, and where the robot begins, m and rad"""
STARTS: dict[str, tuple[float, ...]] = LARGE | {
    "Freiburg101_scan": (17.675, 23.125, 0.0),
    "Freiburg79_scan": (7.875, 9.675, 0.0),
    "lab_ipa": (8.725, 17.125, 0.0),
}
"""where an exploration of a plan begins that is not compared; of another plan where its first tour does"""
_LEAST_M = 1.0  # travel that can be compared
_SILENT = dict.fromkeys((
    "speed", "turn_rate", "slip_position_per_sqrt_m", "slip_position_per_sqrt_rad",
    "slip_heading_per_sqrt_m", "slip_heading_per_sqrt_rad"), 0.0)  # fmt: skip
_CERTAIN = {"motion": _SILENT, "floor_m": 1e-6, "floor_rad": 1e-7}


class Place(NamedTuple):
    """A scene, and where the robot begins; no start: the scene's."""

    scene: str
    start: tuple[float, ...] | None = None


def places_at_hand() -> list[Place]:
    """The market, and the plans with where the robot begins, under SIXTHSENSE_DATA."""
    stems = [(name, Path(name).stem) for name in maps_at_hand()]
    return [Place(name, (STARTS.get(stem) or begin(name)) if name.endswith(".yaml") else None) for name, stem in stems]


def begin(name: str, seed: int = FIRST_SEED) -> tuple[float, ...]:
    """Where a tour of a plan or a scene begins, m and rad."""
    start = world(name, seed, 80.0, preset("default").robot.speed).start
    assert start is not None
    return tuple(start.array().tolist())


def cases() -> list[Case]:
    """All runs; about the longest first, so that processes end together."""
    plans = [Path(name).stem for name in maps_at_hand() if name.endswith(".yaml")]
    small = [name for name in (*plans, *reversed(SHIPPED)) if name not in LARGE or name == "kth_50037765_PLAN3"]
    large = [Case("large", (name,), FIRST_SEED) for name in LARGE if name in plans]
    return [*large, *(Case("perfect", (name,), FIRST_SEED + k) for name in small for k in range(2))]


def figures_of(case: Case) -> Figures:
    """The figures of one run."""
    name = case.setting[0]
    scene = name if name in SHIPPED else str(data_path(f"plans/{name}.yaml"))
    config = preset("default", estimator="ekf-invariant", task="explore", seed=case.seed)
    if case.kind == "large":
        return explored(dataclasses.replace(config, scene=scene, start=LARGE[name]))
    fields: dict[str, Any] = {"world": {"motion": _SILENT}, "assumed": _CERTAIN, "explore": {"loop_closure": False}}
    config = preset("default", estimator="ekf-invariant", task="explore", **fields)
    return explored(dataclasses.replace(config, scene=scene, start=begin(scene, case.seed)))


def explored(config: Config) -> Figures:
    """Explore, and compare the travel; times are processor times."""
    began = time.process_time()
    found = run_by_processor(config)
    spent_s = time.process_time() - began
    metrics, rows = found.metrics, found.trace.stopwatch.rows[1:]
    plan_ms = [row.get("plan", 0.0) for row in rows]
    share = metrics.get("coverage", math.nan)
    reference = nearest_frontier_travel(config, min(share, 0.999)) if share == share else math.nan
    return {
        "world": Path(config.scene).stem, "outcome": metrics["outcome"], "coverage": share,
        "collisions": metrics.get("collisions", math.nan), "left_m2": metrics.get("area_left_m2") or 0.0,
        "nees": metrics.get("pose_nees_world_mean", math.nan), "ate_m": metrics.get("ate_rmse_m", math.nan),
        "home_m": metrics.get("home_error_m", math.nan), "travel_m": metrics["path_length_m"],
        "reference_m": reference, "times_real": metrics["sim_time_s"] / spent_s,
        "plan_ms_p99": float(np.percentile(plan_ms, 99)) if plan_ms else math.nan,
    }  # fmt: skip


def over_reference(found: Sequence[Figures]) -> list[float]:
    """The travel of each run over that of nearest frontiers, where there is any to speak of."""
    return [row["travel_m"] / row["reference_m"] for row in found if row["reference_m"] > _LEAST_M]


def lines(found: Found) -> Iterator[Line]:
    """The table."""
    perfect = [case for case in cases() if case.kind == "perfect"]
    for name in dict.fromkeys(case.setting[0] for case in perfect):
        runs = [found.get(case.key) for case in perfect if case.setting[0] == name]
        yield line(f"perfect pose, {name}", "", runs, _each)
    runs = [found.get(case.key) for case in perfect]
    yield line("perfect pose, travel over nearest frontier", "median <= 0.97, worst <= 1.2", runs, _travel)
    asked = "0 touches, coverage >= 0.998, home within 0.1 m"
    yield line("perfect pose, all runs", asked, runs, _whole)
    for name in LARGE:
        asked = "ends, coverage >= 0.998, travel <= 1.2" if name in ("willow", "kth_50037765_PLAN3") else ""
        runs = [found.get(Case("large", (name,), FIRST_SEED).key)]
        yield line(f"large, {name}", asked, runs, partial(_large, bool(asked)))
        yield line(f"large, {name}", "navigation p99 <= 33 ms, >= 15 x real time", runs, _speed)


def _each(runs: Sequence[Figures]) -> tuple[str, bool]:
    ratios = ", ".join(f"{ratio:.2f}" for ratio in over_reference(runs))
    return f"travel {ratios or '-'}, coverage {min(row['coverage'] for row in runs):.4f}", _whole(runs)[1]


def _travel(runs: Sequence[Figures]) -> tuple[str, bool]:
    ratios = over_reference(runs)
    median, worst = float(np.median(ratios)), max(ratios)
    return f"median {median:.2f}, worst {worst:.2f} of {len(ratios)}", median <= 0.97 and worst <= 1.2


def _whole(runs: Sequence[Figures]) -> tuple[str, bool]:
    touched, coverage = sum(row["collisions"] for row in runs), min(row["coverage"] for row in runs)
    home_m, left_m2 = max(row["home_m"] for row in runs), max(row["left_m2"] for row in runs)
    # What is left has a reason of its own; where that is said, the robot could not reach it.
    is_seen = all(row["coverage"] >= 0.998 or row["left_m2"] > 0.0 for row in runs)
    shown = f"{touched} touches, coverage {coverage:.4f}, home within {home_m:.2f} m, left {left_m2:.1f} m² at most"
    return shown, touched == 0 and is_seen and home_m <= 0.1


def _large(is_asked: bool, runs: Sequence[Figures]) -> tuple[str, bool]:
    (row,) = runs
    ratio = row["travel_m"] / row["reference_m"]
    travel = "not compared" if math.isnan(ratio) else f"{ratio:.2f}"
    shown = f"{row['outcome']}, coverage {row['coverage']:.4f}, travel {travel}, ATE {row['ate_m']:.3f} m, "
    is_whole = row["collisions"] == 0 and (not is_asked or (row["coverage"] >= 0.998 and ratio <= 1.2))
    return f"{shown}NEES {row['nees']:.1f}, {row['collisions']} touches", is_whole and "explored" in row["outcome"]


def _speed(runs: Sequence[Figures]) -> tuple[str, bool]:
    (row,) = runs
    shown = f"p99 {row['plan_ms_p99']:.0f} ms, {row['times_real']:.0f} x real time"
    return shown, row["plan_ms_p99"] <= 33.0 and row["times_real"] >= 15.0


COLUMNS = (
    ("outcome", "s"), ("coverage", ".4f"), ("collisions", ".0f"), ("left_m2", ".1f"), ("nees", ".2f"),
    ("ate_m", ".4f"), ("home_m", ".3f"), ("travel_m", ".0f"), ("reference_m", ".0f"), ("times_real", ".1f"),
    ("plan_ms_p99", ".0f"),
)  # fmt: skip


def explored_places(options: argparse.Namespace) -> list[list[str]]:
    """A table of explorations of the places in `options`; ValueError or InputError for one that cannot be explored."""
    places = [Place(name, tuple(float(x) for x in start) or None) for name, *start in options.world]
    base = preset("default", estimator=options.estimator, task="explore")
    configs = [dataclasses.replace(base, scene=place.scene, start=place.start) for place in places]
    for config in configs:
        mission(load_scene(config.scene, config.map_unknown), config)
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    due = [dataclasses.replace(config, seed=seed) for config in configs for seed in seeds]
    found = pooled(explored, due, options.jobs, warm_up)
    return [["world", *(name for name, _ in COLUMNS)]] + [
        [row["world"], *(format(row[name], form) for name, form in COLUMNS)] for row in found
    ]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--world", nargs="+", action="append", default=[], metavar="W", help="SCENE [X Y THETA]")
    parser.add_argument("--estimator", default="ekf-invariant", help="of these")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="number of seeds of these (1)")
    parser.add_argument("--rows", nargs="+", default=[], metavar="KEY", help="runs whose key begins so (all)")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    parser.add_argument("--minutes", type=float, default=1e9, metavar="M", help="begin no run after so many (no limit)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1, jobs=1, minutes=0.0)
    try:
        if options.world:
            print_table(explored_places(options))
            return 0
        chosen = selected(cases(), options.rows)
        found = measure(chosen, figures_of, options, code_commit(CODE), warm_up)
    except (ValueError, RuntimeError, InputError) as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        print("explored_worlds.py: interrupted; the same command resumes", file=sys.stderr)
        return 130
    if left := len(chosen) - len(found):
        print(f"{left} runs are left; the same command goes on", file=sys.stderr)
    options.keep = options.keep and not left and not options.rows
    finish(options, "explored_worlds", [Line._fields, *(each for each in lines(found) if each.measured)], text=4)
    return 0


if __name__ == "__main__":
    sys.exit(main())
