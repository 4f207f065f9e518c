"""The simulated world: true motion, collisions, noise of wheels and laser, and the clock."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import Config
from sixthsense.core.arcs import driven
from sixthsense.core.geometry import Array, Pose, interpolated
from sixthsense.core.laser import Scan, beam_bearings, sweep_times, time_increment
from sixthsense.core.motion import Slip, draw, slipped
from sixthsense.core.ray_casting import NO_LEGS, Moving, beams_of, cast_among, cast_sweep, near_walls
from sixthsense.core.se2 import Triple, compose, wrapped
from sixthsense.core.source import Command, Tick
from sixthsense.simulation.walkers import Walkers

INTEGRATION_STEP_S = 0.01
"""the longest Runge-Kutta step within a tick; a fast robot has shorter ones, of half its radius at most"""
DRAWS = 5
"""of noise per control tick: of speed and turn rate, and of slip in x, y and heading"""
_MOVED_M = 1.0
"""more than a robot moves in a control tick, slip included"""
_DRAWN_AT_ONCE = 64
"""ticks whose noise is drawn at once, at most: a laser may be much slower than the drive"""


class Drive(NamedTuple):
    """A drive's limits and errors."""

    speed: float
    """top speed, m/s"""
    turn_rate: float
    """top turn rate, rad/s"""
    period_ns: int
    """of a control tick"""
    steps: int
    """of integration in a tick"""
    speed_noise: float
    """scale of the noise of the speed, as a share of it"""
    turn_noise: float
    """scale of the noise of the turn rate, as a share of it"""
    scale_error: float
    """true speed and turn rate are (1 + this) times those the wheels report"""
    drift_rad_per_m: float
    slip: Slip
    radius_m: float
    """of the disc that the robot is"""

    @staticmethod
    def of(config: Config, radius_m: float) -> Drive:
        """That of a configuration."""
        robot, world = config.robot, config.world
        period_ns = round(robot.control_period_s * 1e9)
        step_s = min(INTEGRATION_STEP_S, 0.5 * radius_m / robot.speed)
        return Drive(
            float(robot.speed),
            float(robot.turn_rate),
            period_ns,
            max(1, math.ceil(period_ns * 1e-9 / step_s - 1e-9)),
            float(world.motion.speed),
            float(world.motion.turn_rate),
            float(world.wheel_scale_error),
            float(world.drift_rad_per_m),
            Slip.of(world.motion),
            float(radius_m),
        )


@numba.njit(cache=True, error_model="numpy")
def _touches(x: float, y: float, walls: Array, radius: float) -> bool:
    """Whether a disc at (x, y) is closer than `radius` to any of `walls` (M, 4)."""
    for j in range(walls.shape[0]):
        ax, ay, ex, ey = walls[j, 0], walls[j, 1], walls[j, 2] - walls[j, 0], walls[j, 3] - walls[j, 1]
        s = min(max(((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
        if math.hypot(ax + s * ex - x, ay + s * ey - y) < radius:
            return True
    return False


@numba.njit(cache=True, error_model="numpy")
def _driven_among(
    pose: Triple, control: tuple[float, float, float], steps: int, shift: Triple, walls: Array, radius: float
) -> tuple[Triple, bool]:
    """Where a disc comes at a `control` of speed, turn rate and step (s), with a `shift` per step; whether it touched.

    It stops before the step in which it would come closer than `radius` to any of `walls` (M, 4).
    """
    speed, turn_rate, step_s = control
    for _ in range(steps):
        ahead = compose(driven(pose, speed, turn_rate, step_s, 1), shift)
        if _touches(ahead[0], ahead[1], walls, radius):
            return pose, True
        pose = ahead
    return pose, False


@numba.njit(cache=True, error_model="numpy")
def driven_tick(
    truth: Triple, odometry: Triple, command: tuple[float, float], draws: Array, drive: Drive, solid: Array
) -> tuple[Triple, Triple, bool]:
    """True pose and odometry after a tick with a command of speed and turn rate, and whether the robot touched.

    `draws` (DRAWS,) are of the noise, `solid` (M, 4) is what the robot cannot pass. One slip per tick is distributed
    evenly over its steps of integration.
    """
    v = min(max(command[0], -drive.speed), drive.speed)
    w = min(max(command[1], -drive.turn_rate), drive.turn_rate)
    if v == 0.0 and w == 0.0:
        return truth, odometry, False
    dt, steps = drive.period_ns * 1e-9, drive.steps
    v_true = v * (1.0 + drive.speed_noise * draws[0]) * (1.0 + drive.scale_error)
    w_true = w * (1.0 + drive.turn_noise * draws[1]) * (1.0 + drive.scale_error)
    w_true += drive.drift_rad_per_m * v_true
    position, heading = slipped(drive.slip, v_true * dt, w_true * dt)
    sigma_m, sigma_rad = math.sqrt(position), math.sqrt(heading)
    shift = (sigma_m * draws[2] / steps, sigma_m * draws[3] / steps, wrapped(sigma_rad * draws[4] / steps))
    found, touched = _driven_among(truth, (v_true, w_true, dt / steps), steps, shift, solid, drive.radius_m)
    return found, driven(odometry, v, w, dt / steps, steps), touched


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
        self._place(walls, glass)
        self._rng = rng
        self._draws = np.zeros((0, DRAWS))  # of ticks until the next scan
        self._truth = start
        self._odometry = start
        self._ticks = 0
        self._collided = False
        laser = config.laser
        self._bearings = beam_bearings(laser)
        self._beams = beams_of(self._bearings)
        self._times_s = sweep_times(laser.beams, time_increment(laser))
        # True poses at the last control ticks, back to the beginning of a sweep.
        self._past: deque[Sequence[float]] = deque([start.array().tolist()], maxlen=laser.period_ticks + 2)

    def _place(self, walls: Array, glass: Array | None = None) -> None:
        """Have the robot among `walls` and `glass` from now on."""
        laser, robot = self._config.laser, self._config.robot
        solid = walls if glass is None else np.concatenate([walls, glass])
        # Twice the top speed: noise makes the robot faster than its wheels say.
        between_scans_m = 2.0 * robot.speed * laser.period_ticks * robot.control_period_s
        self._visible = near_walls(walls, laser.max_range + _MOVED_M + 2.0 * robot.speed * laser.sweep_s)
        self._solid = near_walls(solid, self.drive.radius_m + _MOVED_M + between_scans_m)

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

    def _move(self, command: Command) -> None:
        truth, odometry = self._truth, self._odometry
        found, by_wheels, self._collided = driven_tick(
            (truth.x, truth.y, truth.theta),
            (odometry.x, odometry.y, odometry.theta),
            (float(command.speed), float(command.turn_rate)),
            self._noise()[0],
            self.drive,
            self._solid(truth.x, truth.y),
        )
        self._draws = self._draws[1:]
        self._truth, self._odometry = Pose(*found), Pose(*by_wheels)
        self._past.append(found)

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
        walls = self._visible(T_world_laser.x, T_world_laser.y)
        legs = NO_LEGS if self._walkers is None else self._walkers.legs()
        if laser.sweep_s == 0.0:
            beams = self._beams if noise.bearing_rad == 0.0 else beams_of(bearings)
            ranges = cast_among(T_world_laser, beams, walls, laser.max_range, legs)
        else:
            ranges = cast_sweep(self._sweep(), bearings, walls, laser.max_range, Moving(legs, self._times_s))
        ranges += draw(self._rng, noise.distribution, noise.range_m, laser.beams)
        return Scan.from_config(np.maximum(ranges, 0.0), laser)

    def _sweep(self) -> Array:
        """(N, 3) true pose of the laser at each beam's time, interpolated linearly between control ticks."""
        stamps_s = 1e-9 * self.drive.period_ns * np.arange(1 - len(self._past), 1, dtype=np.float64)
        poses = interpolated(stamps_s, np.array(self._past), self._times_s)
        return compose(poses, np.array(self._config.laser.mount))
