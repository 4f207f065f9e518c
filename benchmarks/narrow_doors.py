"""Narrow doors: how much wider than the robot a door must be to be passed, and whether a robot touches it.

Two rooms of 4 m, divided by a wall with one door: a thin or a thick wall, at an angle to the cells of the map. The
robot is a disc of 0.4 m. A narrow door is closed by the clearance alone; the robot tries it when nothing else is left.
`explored_worlds.py --rows door` measures it.
"""

from __future__ import annotations

import math

import numpy as np
from harness import Figures

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.running.runs import QUIET, simulate
from sixthsense.sources.scene import Scene

RADIUS_M, THICK_M = 0.2, 0.15
SIZE_M = 8.0, 4.0
DOOR = np.array([4.013, 2.017])  # off the cells' edges
WIDER_M = 0.05, 0.08, 0.1, 0.13, 0.17
ANGLES_RAD = 0.0, 0.2, 0.5, 0.8
FACES = "thin", "thick"


def two_rooms(wider_m: float, angle_rad: float, face: str) -> Scene:
    """The rooms and the wall with the door."""
    (width, height), is_thick = SIZE_M, face == "thick"
    corners = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    across = np.array([math.cos(angle_rad), math.sin(angle_rad)])
    along = np.array([-across[1], across[0]])
    half = 0.5 * (2.0 * RADIUS_M + wider_m)
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
    return Scene("two rooms", np.array(walls), start, RADIUS_M, None, (), (0.0, 0.0, width, height))


def door_figures(wider_m: float, angle_rad: float, face: str, seed: int) -> Figures:
    """Explore the two rooms."""
    run = simulate(preset("default", seed=seed, task="explore"), two_rooms(wider_m, angle_rad, face), watch=QUIET)
    across = math.cos(angle_rad), math.sin(angle_rad)
    passed = ((np.array(run.trace.truths)[:, :2] - DOOR) @ across > 0.0).any()
    metrics = run.metrics
    home_m, touched = metrics.get("home_error_m", math.inf), metrics["collisions"]
    return {"passed": int(passed), "collisions": touched, "home_m": home_m, "coverage": metrics["coverage"]}
