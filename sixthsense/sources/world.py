"""The simulated world: true motion, collisions, noise of wheels and laser, and the clock."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose, interpolated
from sixthsense.core.laser import Scan, beam_bearings, sweep_times, time_increment
from sixthsense.core.motion import draw
from sixthsense.core.ray_casting import NO_LEGS, Moving, NearWalls, cast_among, cast_sweep
from sixthsense.core.source import Command, ControlTicks, Tick
from sixthsense.sources.drive import DRAWS, Drive, Driving, driven_tick
from sixthsense.sources.walkers import Walkers

_MOVED_M = 1.0
"""more than a robot moves in a control tick, slip included"""
_DRAWN_AT_ONCE = 64
"""ticks whose noise is drawn at once, at most: a laser may be much slower than the drive"""


class World:
    """A simulated `Source`: each step is one control tick, and every `laser.period_ticks` steps yield a scan."""

    def __init__(
        self,
        walls: Array,
        start: Pose,
        radius_m: float,
        config: Config,
        rng: np.random.Generator,
        glass: Array | None = None,
        walkers: Walkers | None = None,
    ) -> None:
        """Place the robot, a disc of `radius_m`, at `start` among `walls` (N, 2, 2), metres, world frame.

        `glass` (G, 2, 2) stops the robot as walls do, and lets every beam through. `walkers` are people, who stop
        beams, not the robot.
        """
        self._walkers = walkers
        self._config = config
        self.drive = Drive.of(config, radius_m)
        """limits and errors of the robot's drive"""
        laser, robot = config.laser, config.robot
        solid = walls if glass is None else np.concatenate([walls, glass])
        # Twice the top speed: noise makes the robot faster than its wheels say.
        between_scans_m = 2.0 * robot.speed * laser.period_ticks * robot.control_period_s
        self._visible = NearWalls(walls, laser.max_range + _MOVED_M + 2.0 * robot.speed * laser.sweep_s)
        self._solid = NearWalls(solid, radius_m + _MOVED_M + between_scans_m)
        self._rng = rng
        self._draws = np.zeros((0, DRAWS))  # of ticks until the next scan
        self._truth = start
        self._odometry = start
        self._ticks = 0
        self._collided = False
        self._bearings = beam_bearings(laser)
        self._times_s = sweep_times(laser.beams, time_increment(laser))
        # True poses at the last control ticks, back to the beginning of a sweep.
        self._past: deque[Pose] = deque([start], maxlen=laser.period_ticks + 2)

    def step(self, command: Command) -> Tick | None:
        """Drive for one control tick with `command`, clipped to the robot's limits; None after a collision.

        The first step does not move the robot: it returns the scan at the start.
        """
        if self._collided:
            return None
        if self._ticks > 0:
            before = self._truth
            self._move(command)
            if self._walkers is not None:
                self._walkers.step(before, self._truth, 1e-9 * self.drive.period_ns)
        scan = self._sense() if self._ticks % self._config.laser.period_ticks == 0 else None
        stamp_ns = self._ticks * self.drive.period_ns
        tick = Tick(stamp_ns, self._odometry, scan, truth=self._truth, collided=self._collided)
        if self._walkers is not None:
            by_robot, by_walkers = self._walkers.touches
            tick = replace(tick, walkers=self._walkers.poses, touches=(by_robot, by_walkers))
        self._ticks += 1
        return tick

    def between_scans(self) -> Driving | None:
        """What a kernel needs for the ticks before the next scan; None where people walk, who move in each tick."""
        left = -self._ticks % self._config.laser.period_ticks
        if self._walkers is not None or self._collided or not left:
            return None
        return Driving(
            (self._truth.x, self._truth.y, self._truth.theta),
            (self._odometry.x, self._odometry.y, self._odometry.theta),
            self._noise()[:left],
            self._solid.at(self._truth.x, self._truth.y),
        )

    def moved(self, passed: ControlTicks, collided: bool) -> None:
        """Take in ticks that a kernel has driven."""
        self._truth, self._odometry = Pose(*passed.truths[-1].tolist()), Pose(*passed.odometry[-1].tolist())
        self._draws, self._collided = self._draws[len(passed) :], collided
        self._past.extend(Pose(*row) for row in passed.truths.tolist())
        self._ticks += len(passed)

    def _move(self, command: Command) -> None:
        truth, odometry = self._truth, self._odometry
        found, by_wheels, self._collided = driven_tick(
            (truth.x, truth.y, truth.theta),
            (odometry.x, odometry.y, odometry.theta),
            (float(command.speed), float(command.turn_rate)),
            self._noise()[0],
            self.drive,
            self._solid.at(truth.x, truth.y),
        )
        self._draws = self._draws[1:]
        self._truth, self._odometry = Pose(*found), Pose(*by_wheels)
        self._past.append(self._truth)

    def _noise(self) -> Array:
        """(K, DRAWS) draws of the next ticks, K at least 1: those until the next scan, which draws after them."""
        if not len(self._draws):
            rng, distribution = self._rng, self._config.world.motion.distribution
            count = min(1 + -self._ticks % self._config.laser.period_ticks, _DRAWN_AT_ONCE)
            if distribution == "gaussian":
                self._draws = rng.standard_normal((count, DRAWS))
            else:
                rows = [(*draw(rng, distribution, 1.0, 2), *rng.standard_normal(DRAWS - 2)) for _ in range(count)]
                self._draws = np.array(rows)
        return self._draws

    def _sense(self) -> Scan:
        laser, noise = self._config.laser, self._config.world.laser
        T_world_laser = self._truth @ Pose(*laser.mount)
        bearings = self._bearings + draw(self._rng, noise.distribution, noise.bearing_rad, laser.beams)
        walls = self._visible.at(T_world_laser.x, T_world_laser.y)
        legs = NO_LEGS if self._walkers is None else self._walkers.legs()
        if laser.sweep_s == 0.0:
            ranges = cast_among(T_world_laser, bearings, walls, laser.max_range, legs)
        else:
            ranges = cast_sweep(self._sweep(), bearings, walls, laser.max_range, Moving(legs, self._times_s))
        ranges += draw(self._rng, noise.distribution, noise.range_m, laser.beams)
        return Scan.from_config(np.maximum(ranges, 0.0), laser)

    def _sweep(self) -> Array:
        """(N, 3) true pose of the laser at each beam's time, interpolated linearly between control ticks."""
        stamps_s = 1e-9 * self.drive.period_ns * np.arange(1 - len(self._past), 1, dtype=np.float64)
        poses = interpolated(stamps_s, np.array([pose.array() for pose in self._past]), self._times_s)
        x, y, theta = self._config.laser.mount
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        return np.column_stack([poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y, poses[:, 2] + theta])
