"""The simulated world: true motion, collisions, noise of wheels and laser, and the clock."""

from __future__ import annotations

import math
from collections import deque

import numba
import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.core.arcs import driven
from sixthsense.core.geometry import Array, Pose, interpolated
from sixthsense.core.laser import Scan, beam_bearings, sweep_times, time_increment
from sixthsense.core.motion import Slip, draw, slipped
from sixthsense.core.ray_casting import NO_LEGS, Moving, beams_of, cast_among, cast_sweep, near_walls
from sixthsense.core.se2 import Triple, compose, wrapped
from sixthsense.core.source import Command, Tick, seconds
from sixthsense.simulation.scene_grid import wall_distance
from sixthsense.simulation.walkers import Walkers

_INTEGRATION_STEP_S = 0.01
"""the longest Runge-Kutta step within a tick; a fast robot has shorter ones, of half its radius at most"""
_MOVED_M = 1.0
"""more than a robot moves in a control tick, slip included"""


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
        for j in range(walls.shape[0]):
            if wall_distance(ahead[0], ahead[1], walls, j) < radius:
                return pose, True
        pose = ahead
    return pose, False


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
        self._walkers, self._config, self._rng, self._radius_m = walkers, config, rng, radius_m
        self._place(walls, glass)
        self._period_ns = round(config.robot.control_period_s * 1e9)
        step_s = min(_INTEGRATION_STEP_S, 0.5 * radius_m / config.robot.speed)
        self._steps = max(1, math.ceil(seconds(float(self._period_ns)) / step_s - 1e-9))
        self._slip = Slip.of(config.world.motion)
        self._truth = self._odometry = start
        self._ticks, self._collided = 0, False
        laser = config.laser
        self._bearings = beam_bearings(laser)
        self._beams = beams_of(self._bearings)
        self._times_s = sweep_times(laser.beams, time_increment(laser))
        # True poses at the last control ticks, back to the beginning of a sweep.
        self._past: deque[Triple] = deque([start.triple()], maxlen=laser.period_ticks + 2)

    def _place(self, walls: Array, glass: Array | None = None) -> None:
        """Have the robot among `walls` and `glass` from now on."""
        laser, robot = self._config.laser, self._config.robot
        solid = walls if glass is None else np.concatenate([walls, glass])
        # Twice the top speed: noise makes the robot faster than its wheels say.
        between_scans_m = 2.0 * robot.speed * laser.period_ticks * robot.control_period_s
        self._visible = near_walls(walls, laser.max_range + _MOVED_M + 2.0 * robot.speed * laser.sweep_s)
        self._solid = near_walls(solid, self._radius_m + _MOVED_M + between_scans_m)

    def step(self, command: Command) -> Tick | None:
        """Drive for one control tick with `command`, clipped to the robot's limits; None after a collision.

        The first step does not move the robot: it returns the scan at the start. Raises InputError for a command that
        is not finite.
        """
        if not math.isfinite(command.speed + command.turn_rate):
            raise InputError("command", f"found {command}", "a finite speed and turn rate")
        if self._collided:
            return None
        people, dt = self._walkers, seconds(float(self._period_ns))
        if self._ticks > 0:
            before = self._truth
            self._move(command, dt)
            if people is not None:
                people.step(before, self._truth, dt)
        scan = self._sense(dt) if self._ticks % self._config.laser.period_ticks == 0 else None
        stamp_ns = self._ticks * self._period_ns
        self._ticks += 1
        poses, touches = (None, (0, 0)) if people is None else (people.poses, (people.touches[0], people.touches[1]))
        return Tick(
            stamp_ns, self._odometry, scan, truth=self._truth, collided=self._collided, walkers=poses, touches=touches
        )

    def _move(self, command: Command, dt: float) -> None:
        """Drive for a tick of `dt` s. One slip is distributed evenly over its steps of integration."""
        robot, world, steps = self._config.robot, self._config.world, self._steps
        draws = *draw(self._rng, world.motion.distribution, 1.0, 2), *self._rng.standard_normal(3)
        v = min(max(float(command.speed), -robot.speed), robot.speed)
        w = min(max(float(command.turn_rate), -robot.turn_rate), robot.turn_rate)
        if v != 0.0 or w != 0.0:
            scale = 1.0 + world.wheel_scale_error
            v_true = v * (1.0 + world.motion.speed * draws[0]) * scale
            w_true = w * (1.0 + world.motion.turn_rate * draws[1]) * scale + world.drift_rad_per_m * v_true
            sigma_m, sigma_rad = map(math.sqrt, slipped(self._slip, v_true * dt, w_true * dt))
            shift = sigma_m * draws[2] / steps, sigma_m * draws[3] / steps, wrapped(sigma_rad * draws[4] / steps)
            place, control = self._truth.triple(), (v_true, w_true, dt / steps)
            solid = self._solid(self._truth.x, self._truth.y)
            found, self._collided = _driven_among(place, control, steps, shift, solid, self._radius_m)
            self._truth = Pose(*found)
            self._odometry = Pose(*driven(self._odometry.triple(), v, w, dt / steps, steps))
        self._past.append(self._truth.triple())

    def _sense(self, dt: float) -> Scan:
        """The scan at the end of a tick of `dt` s."""
        laser, noise = self._config.laser, self._config.world.laser
        bearings = self._bearings + draw(self._rng, noise.distribution, noise.bearing_rad, laser.beams)
        T_world_laser = self._truth @ Pose(*laser.mount)
        walls = self._visible(T_world_laser.x, T_world_laser.y)
        legs = NO_LEGS if self._walkers is None else self._walkers.legs()
        if laser.sweep_s == 0.0:
            beams = self._beams if noise.bearing_rad == 0.0 else beams_of(bearings)
            ranges = cast_among(T_world_laser, beams, walls, laser.max_range, legs)
        else:
            # The true pose of the laser at each beam's time, interpolated between control ticks.
            stamps_s = dt * np.arange(1 - len(self._past), 1, dtype=np.float64)
            poses = compose(interpolated(stamps_s, np.array(self._past), self._times_s), np.array(laser.mount))
            ranges = cast_sweep(poses, bearings, walls, laser.max_range, Moving(legs, self._times_s))
        ranges += draw(self._rng, noise.distribution, noise.range_m, laser.beams)
        return Scan.from_config(np.maximum(ranges, 0.0), laser)
