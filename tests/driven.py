"""A robot that drives a tour through two rooms, as a log: as it is, and as people spoil one."""

import dataclasses
import functools
import math

import numpy as np

import sixthsense as ss
from sixthsense.config import Config, merge, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Command, Tick
from sixthsense.figures.run import Run
from sixthsense.logs.log import Log
from sixthsense.simulation.world import World

_LINES = [
    (-0.4, -0.7, 9.8, -0.7), (9.8, -0.7, 9.8, 6.4), (9.8, 6.4, -0.4, 6.4), (-0.4, 6.4, -0.4, -0.7),
    (4.7, -0.7, 4.7, 3.6), (6.9, 2.6, 8.1, 2.9), (8.1, 2.9, 7.9, 4.0), (7.9, 4.0, 6.9, 2.6), (1.2, 4.6, 2.0, 4.9),
    (2.0, 4.9, 1.9, 5.7), (1.9, 5.7, 1.2, 4.6), (2.3, -0.7, 2.3, 0.1), (9.8, 5.1, 9.0, 5.1),
]  # fmt: skip
WALLS = np.array(_LINES).reshape(-1, 2, 2)
START = Pose(0.7, 1.3, -0.2)
TOUR = [
    (3.7, 0.9), (3.8, 5.0), (5.8, 5.1), (6.0, 0.6), (8.9, 0.8), (8.8, 4.5), (5.9, 5.3), (3.9, 4.4), (0.9, 3.6),
    (0.6, 1.1), (3.4, 1.2), (3.6, 4.9),
]  # fmt: skip
MOUNT = (0.14, 0.05, 0.22)


def config(**changes: object) -> Config:
    """Of a robot with a laser beside its middle."""
    laser = {"beams": 240, "max_range": 11.0, "mount": MOUNT}
    return merge(preset("log"), {"seed": 3, "laser": laser, "robot": {"control_period_s": 0.05}, **changes})


@functools.cache
def ticks() -> tuple[Tick, ...]:
    """The ticks of the tour that have scans, without truth."""
    settings = config(laser={"beams": 240, "max_range": 11.0, "mount": MOUNT, "period_ticks": 3})
    goals, command = [*TOUR], Command()
    world = World(WALLS, START, 0.2, settings, random_streams(7).world)
    found = []
    while goals:
        tick = world.step(command)
        assert tick is not None and tick.truth is not None and not tick.collided
        if tick.scan is not None:
            found.append(dataclasses.replace(tick, truth=None))
        x, y = goals[0][0] - tick.truth.x, goals[0][1] - tick.truth.y
        if math.hypot(x, y) < 0.1:
            goals.pop(0)
        turn = (math.atan2(y, x) - tick.truth.theta + math.pi) % (2.0 * math.pi) - math.pi
        command = Command(0.5 * max(0.0, 1.0 - 3.0 * abs(turn)), float(np.clip(3.0 * turn, -0.8, 0.8)))
    return tuple(found)


def mirrored() -> list[Tick]:
    """Ranges from right to left."""
    found = []
    for tick in ticks():
        assert tick.scan is not None
        found.append(
            dataclasses.replace(tick, scan=dataclasses.replace(tick.scan, ranges=tick.scan.ranges[::-1].copy()))
        )
    return found


def mount_left(by_m: float = -0.31) -> list[Tick]:
    """A mount that is stated `by_m` to the left of the true one."""
    found, off = [], Pose(0.0, by_m)
    for tick in ticks():
        assert tick.scan is not None
        scan = dataclasses.replace(tick.scan, T_robot_laser=off @ tick.scan.T_robot_laser)
        found.append(dataclasses.replace(tick, scan=scan))
    return found


def kidnapped() -> tuple[list[Tick], float]:
    """Carried over a third of the way while the wheels stand; and when, s after the first scan."""
    own = ticks()
    first, past = int(0.35 * len(own)), int(0.62 * len(own))
    back, late_ns = own[first].odometry @ own[past].odometry.inverse(), own[first].stamp_ns - own[past].stamp_ns
    late_ns += own[1].stamp_ns - own[0].stamp_ns
    later = [
        dataclasses.replace(tick, odometry=back @ tick.odometry, stamp_ns=tick.stamp_ns + late_ns)
        for tick in own[past:]
    ]
    return [*own[: first + 1], *later], 1e-9 * (own[first].stamp_ns - own[0].stamp_ns)


def replayed(own: list[Tick] | tuple[Tick, ...], **changes: object) -> Run:
    """A replay of ticks by scan matching."""
    return ss.replay(Log(own), config(**changes), progress=False)
