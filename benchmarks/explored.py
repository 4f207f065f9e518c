"""Explorations: shipped scenes, plans, houses, odd robots, narrow doors, people."""

from __future__ import annotations

import csv
import functools
import itertools
import math
import time
from typing import Any

import numpy as np
from generated_worlds import odd_robot
from nearest_frontier import CELL_M, nearest_frontier_travel
from runs import Figures, Setting, chosen, data_path, run
from worlds import plan, world

from sixthsense.config import Config, preset
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.record.trace import Trace
from sixthsense.simulation.scene import Scene

FIRST_SEED, HOUSE_SEED = 1000, 7000
SHIPPED = ("rectangle", "block", "apartment", "office", "loop")
LARGE = {
    "willow": (28.85, 26.65, 0.0), "kth_50037765_PLAN3": (130.0, 27.8, 0.0),
    "stata": (-20.15, 9.84, 0.0), "building_31": (-7.575, 4.675, 0.0),
}  # fmt: skip
"""plans of large buildings, and where the robot begins, m and rad"""
_LEAST_M = 3.0  # travel that can be compared
_SLACK_S = 120.0  # for turns, where the travel that a run is allowed is short
DOOR_RADIUS_M, THICK_M, SIZE_M = 0.2, 0.15, (8.0, 4.0)
DOOR = np.array([4.013, 2.017])  # off the cells' edges
DOORS = [*itertools.product((0.0, 0.2, 0.5, 0.8), (False, True), range(3))]
"""angle to the map's cells, whether the wall is thick, and the seed of each exploration of a door"""
STRAY_M = 0.15
FRONT_ENDS = {"ekf-invariant": "landmarks", "isam2": "scan-matching"}


def shipped(setting: Setting, seed: int) -> Figures:
    """A shipped scene, with the default configuration."""
    return timed(preset(scene=setting[0], task="explore", max_time=3600.0, seed=seed))


def large(setting: Setting, seed: int) -> Figures:
    """A large building, with the default configuration."""
    name = setting[0]
    return compared(preset(task="explore", seed=seed, scene=plan(name), start=LARGE[name]))


def house(setting: Setting, seed: int) -> Figures:
    """A floor plan of a house, each with its own seed."""
    name, start = houses()[seed - HOUSE_SEED]
    scene = str(data_path(f"houses/{name}.yaml"))
    return compared(preset(task="explore", seed=seed, scene=scene, start=start))


@functools.cache
def houses() -> list[tuple[str, tuple[float, ...]]]:
    """Each house, and where the robot begins in it, m and rad."""
    with data_path("houses/starts.csv").open() as lines:
        return [
            (row["name"], tuple(float(row[k]) for k in ("x_m", "y_m", "theta_rad"))) for row in csv.DictReader(lines)
        ]


def timed(config: Config) -> Figures:
    """An exploration, with its processor time."""
    began = time.process_time()
    found = run(config)
    spent_s = time.process_time() - began
    plan_ms = [row.get("plan", 0.0) for row in found.trace.stopwatch.rows[1:]]
    return chosen(found.metrics) | {
        "times_real_time": found.metrics["sim_time_s"] / spent_s, "processor_s": spent_s,
        "plan_ms_p99": float(np.percentile(plan_ms, 99)) if plan_ms else None,
    }  # fmt: skip


def compared(config: Config) -> Figures:
    """The same beside the travel of a robot that drives to the nearest frontier, where there is any to speak of."""
    found = timed(config)
    share = found.get("coverage", math.nan)
    reference_m = math.nan if math.isnan(share) else nearest_frontier_travel(config, min(share, 0.999))
    if not reference_m > _LEAST_M:  # NaN, too
        return found
    ratio = found["travel_m"] / reference_m
    return found | {"compared_m": found["travel_m"], "reference_m": reference_m, "ratio": ratio}


def odd(setting: Setting, seed: int) -> Figures:
    """A robot of any size and speed with an odd laser in a generated world: ends within ten times the reference."""
    family, _, fields = odd_robot(seed)
    config = preset("default", task="explore", seed=seed, **fields)
    scene = world(family, seed, 80.0, config.robot.speed)
    # The reference passes the same doors, in its larger cells; behind doors too narrow for the robot it sees less.
    robot = config.robot.replaced(radius=fields["robot"]["radius"] - 0.5 * CELL_M)
    fits = config.replaced(robot=robot, grid=config.grid.replaced(clearance_m=0.0))
    references_m = (nearest_frontier_travel(fits, share, scene) for share in (0.95, 0.8, 0.6, 0.4, 0.2))
    reference_m = next((found for found in references_m if not math.isnan(found)), 0.0)
    found = run(config.replaced(max_time=10.0 * reference_m / config.robot.speed + _SLACK_S), scene).metrics
    return chosen(found) | {"ended": int("explored" in found["outcome"])}


def door(setting: Setting, seed: int) -> Figures:
    """Two rooms and a door that is so much wider than the robot."""
    angle_rad, is_thick, draw = DOORS[seed]
    config = preset("default", seed=FIRST_SEED + draw, task="explore")
    made = run(config, two_rooms(float(setting[0]), angle_rad, is_thick))
    across = math.cos(angle_rad), math.sin(angle_rad)
    passed = ((np.array(made.trace.truths)[:, :2] - DOOR) @ across > 0.0).any()
    return chosen(made.metrics) | {"passed": int(passed)}


def two_rooms(wider_m: float, angle_rad: float, is_thick: bool) -> Scene:
    """The rooms and the wall with the door."""
    width, height = SIZE_M
    corners = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    across = np.array([math.cos(angle_rad), math.sin(angle_rad)])
    along = np.array([-across[1], across[0]])
    half = 0.5 * (2.0 * DOOR_RADIUS_M + wider_m)
    walls: list[Array] = list(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    for side, edge in ((-1.0, 0.0), (1.0, height)):
        jambs = []
        for depth in (0.0, THICK_M) if is_thick else (0.0,):
            middle = DOOR + depth * across
            jambs.append(middle + side * half * along)
            walls.append(np.array([jambs[-1], middle + (edge - middle[1]) / along[1] * along]))
        if is_thick:
            walls.append(np.array(jambs))
    start = Pose(1.5, 2.0, 0.0)
    return Scene("two rooms", np.array(walls), start, DOOR_RADIUS_M, None, (), (0.0, 0.0, width, height))


def people(setting: Setting, seed: int) -> Figures:
    """A scene among walkers, and what they have left in the map."""
    scene, estimator, walkers = setting
    fields: dict[str, Any] = {"front_end": FRONT_ENDS[estimator], "world": {"walkers": int(walkers)}}
    found = run(preset(scene=scene, estimator=estimator, max_time=3000.0, seed=seed, **fields))
    return chosen(found.metrics) | left_by_people(found.trace)


def left_by_people(trace: Trace) -> Figures:
    """Share of the seen cells that are obstacles far from every wall, and landmarks that are as far."""
    assert trace.scene is not None and trace.grid is not None
    walls = trace.scene.walls
    cells = np.argwhere(trace.grid.obstacles)
    places = np.array(trace.grid.origin) + trace.config.grid.cell_m * (cells[:, ::-1] + 0.5)
    extents = [trace.records[i].extent.mean(axis=0) for i in trace.final.ids[trace.final.walls].tolist()]
    marks = np.concatenate([trace.final.landmarks[~trace.final.walls], np.array(extents).reshape(-1, 2)])
    stray, stray_landmarks = (
        sum(float(point_segment_distance(point, walls).min()) > STRAY_M for point in points)
        for points in (places, marks)
    )
    return {"stray_share": stray / np.count_nonzero(trace.grid.seen), "stray_landmarks": stray_landmarks}
