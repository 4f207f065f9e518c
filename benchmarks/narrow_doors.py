"""Narrow doors: how much wider than the robot a door must be to be passed, and whether a robot touches it.

    python benchmarks/narrow_doors.py --seeds 3

Two rooms of 4 m, divided by a wall with one door: a thin or a thick wall, at an angle to the cells of the map. The
robot is a disc of 0.4 m. A narrow door is closed by the clearance alone; the robot tries it when nothing else is left.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from harness import arguments, check_at_least, finish, pooled

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.running.runs import QUIET, simulate
from sixthsense.running.warmup import warm_up
from sixthsense.sources.scene import Scene

RADIUS_M, THICK_M = 0.2, 0.15
SIZE_M = 8.0, 4.0
DOOR = np.array([4.013, 2.017])  # off the cells' edges
WIDER_M = 0.05, 0.08, 0.1, 0.13, 0.17
ANGLES_RAD = 0.0, 0.2, 0.5, 0.8


class Case(NamedTuple):
    """One door, and the seed of the run."""

    wider_m: float
    angle_rad: float
    thick: bool
    seed: int


class Found(NamedTuple):
    """What came of it."""

    passed: bool
    collided: bool
    at_home: bool
    coverage: float


def two_rooms(case: Case) -> Scene:
    """The rooms and the wall with the door."""
    width, height = SIZE_M
    corners = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    across = np.array([math.cos(case.angle_rad), math.sin(case.angle_rad)])
    along = np.array([-across[1], across[0]])
    half = 0.5 * (2.0 * RADIUS_M + case.wider_m)
    walls: list[Array] = list(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    for side, edge in ((-1.0, 0.0), (1.0, height)):
        jambs = []
        for depth in (0.0, THICK_M) if case.thick else (0.0,):
            face = DOOR + depth * across
            jambs.append(face + side * half * along)
            walls.append(np.array([jambs[-1], face + (edge - face[1]) / along[1] * along]))
        if case.thick:
            walls.append(np.array(jambs))
    start = Pose(1.5, 2.0, 0.0)
    return Scene("two rooms", np.array(walls), start, RADIUS_M, None, (), (0.0, 0.0, width, height))


def explore(case: Case) -> Found:
    """Explore the two rooms."""
    run = simulate(preset("default", seed=case.seed, task="explore"), two_rooms(case), watch=QUIET)
    across = math.cos(case.angle_rad), math.sin(case.angle_rad)
    passed = bool(((np.array(run.trace.truths)[:, :2] - DOOR) @ across > 0.0).any())
    at_home = run.metrics.get("home_error_m", math.inf) < 0.2
    return Found(passed, run.outcome == "collided", at_home, run.metrics["coverage"])


def main() -> int:
    parser = arguments(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="runs of each door (3)")
    parser.add_argument("--first-seed", type=int, default=1000, metavar="S", help="the first seed (1000)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="processes (1)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1, jobs=1)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    due = [Case(*case) for case in itertools.product(WIDER_M, ANGLES_RAD, (False, True), seeds)]
    found = dict(zip(due, pooled(explore, due, options.jobs, warm_up), strict=True))
    lines: list[Sequence[str]] = [("wider by m", *(f"{angle:g} rad" for angle in ANGLES_RAD), "coverage, least")]
    for wider in WIDER_M:
        cells = [
            [found[case] for case in due if (case.wider_m, case.angle_rad) == (wider, angle)] for angle in ANGLES_RAD
        ]
        row = [f"{sum(one.passed for one in runs)} of {len(runs)}" for runs in cells]
        lines.append([f"{wider:g}", *row, f"{min(one.coverage for runs in cells for one in runs):.4f}"])
    collided, away = sum(one.collided for one in found.values()), sum(not one.at_home for one in found.values())
    finish(
        options, "narrow_doors", lines, [("runs", "collided", "not home"), (str(len(due)), str(collided), str(away))]
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
