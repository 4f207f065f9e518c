"""The simulated world: true motion, collisions, noise of wheels and laser, and the clock."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numba
import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose, interpolated
from sixthsense.core.laser import Scan, beam_bearings, sweep_times, time_increment
from sixthsense.core.motion import draw, rk4, slip_variances
from sixthsense.core.pose_kernels import Triple, composed, driven
from sixthsense.core.ray_casting import NO_LEGS, Moving, NearWalls, cast_among, cast_sweep
from sixthsense.core.source import Command, Tick
from sixthsense.sources.walkers import Walkers

_MOVED_M = 1.0
"""more than a robot moves in a control tick, slip included"""


@numba.njit(cache=True, error_model="numpy")
def _touches(x0: float, y0: float, x1: float, y1: float, walls: Array, radius: float) -> bool:
    """Whether a disc moving from (x0, y0) to (x1, y1) comes closer than `radius` to any of `walls` (M, 4)."""
    mx, my = x1 - x0, y1 - y0
    for j in range(walls.shape[0]):
        ax, ay, bx, by = walls[j, 0], walls[j, 1], walls[j, 2], walls[j, 3]
        if min(ax, bx) - radius > max(x0, x1) or max(ax, bx) + radius < min(x0, x1):
            continue
        if min(ay, by) - radius > max(y0, y1) or max(ay, by) + radius < min(y0, y1):
            continue
        ex, ey = bx - ax, by - ay
        # Unless two segments cross, their distance is attained at an end of one of them.
        length_sq = max(ex * ex + ey * ey, 1e-300)
        for px, py in ((x0, y0), (x1, y1)):
            s = min(max(((px - ax) * ex + (py - ay) * ey) / length_sq, 0.0), 1.0)
            if math.hypot(ax + s * ex - px, ay + s * ey - py) < radius:
                return True
        length_sq = max(mx * mx + my * my, 1e-300)
        for px, py in ((ax, ay), (bx, by)):
            s = min(max(((px - x0) * mx + (py - y0) * my) / length_sq, 0.0), 1.0)
            if math.hypot(x0 + s * mx - px, y0 + s * my - py) < radius:
                return True
        cross = mx * ey - my * ex
        t = ((ax - x0) * ey - (ay - y0) * ex) / cross
        u = ((ax - x0) * my - (ay - y0) * mx) / cross
        if 0.0 <= t <= 1.0 and 0.0 <= u <= 1.0:
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
        ahead = composed(driven(pose, speed, turn_rate, step_s, 1), shift)
        if _touches(pose[0], pose[1], ahead[0], ahead[1], walls, radius):
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
        self._walkers = walkers
        self._radius_m = radius_m
        self._config = config
        self._place(walls, glass)
        self._rng = rng
        self._truth = start
        self._odometry = start
        self._period_ns = round(config.robot.control_period_s * 1e9)
        self._ticks = 0
        self._collided = False
        self._bearings = beam_bearings(config.laser)
        self._times_s = sweep_times(config.laser.beams, time_increment(config.laser))
        # True poses at the last control ticks, back to the beginning of a sweep.
        self._past: deque[Pose] = deque([start], maxlen=config.laser.period_ticks + 2)

    def step(self, command: Command) -> Tick | None:
        """Drive for one control tick with `command`, clipped to the robot's limits; None after a collision.

        The first step does not move the robot: it returns the scan at the start.
        """
        if self._collided:
            return None
        if self._ticks > 0:
            before = self._truth
            self._drive(command)
            self._past.append(self._truth)
            if self._walkers is not None:
                self._walkers.step(before, self._truth, 1e-9 * self._period_ns)
        scan = self._sense() if self._ticks % self._config.laser.period_ticks == 0 else None
        stamp_ns = self._ticks * self._period_ns
        tick = Tick(stamp_ns, self._odometry, scan, truth=self._truth, collided=self._collided)
        if self._walkers is not None:
            by_robot, by_walkers = self._walkers.touches
            tick = replace(tick, walkers=self._walkers.poses, touches=(by_robot, by_walkers))
        self._ticks += 1
        return tick

    def _place(self, walls: Array, glass: Array | None = None) -> None:
        """Have the robot among `walls` and `glass` from now on."""
        laser, robot = self._config.laser, self._config.robot
        solid = walls if glass is None else np.concatenate([walls, glass])
        # Twice the top speed: noise makes the robot faster than its wheels say.
        self._visible = NearWalls(walls, laser.max_range + _MOVED_M + 2.0 * robot.speed * laser.sweep_s)
        self._solid = NearWalls(solid, self._radius_m + _MOVED_M)

    def _drive(self, command: Command) -> None:
        robot, world, rng = self._config.robot, self._config.world, self._rng
        v = min(max(command.speed, -robot.speed), robot.speed)
        w = min(max(command.turn_rate, -robot.turn_rate), robot.turn_rate)
        noise = world.motion
        control = draw(rng, noise.distribution, 1.0, 2)
        slip = rng.standard_normal(3)
        if v == 0.0 and w == 0.0:
            return
        dt = self._period_ns * 1e-9
        self._odometry = rk4(self._odometry, v, w, dt, robot.integration_step_s)
        v_true = v * (1.0 + noise.speed * float(control[0])) * (1.0 + world.wheel_scale_error)
        w_true = w * (1.0 + noise.turn_rate * float(control[1])) * (1.0 + world.wheel_scale_error)
        w_true += world.drift_rad_per_m * v_true
        steps = max(1, math.ceil(dt / robot.integration_step_s - 1e-9))
        position, heading = slip_variances(noise, v_true * dt, w_true * dt)
        # One slip per tick, distributed evenly over its integration steps.
        sigmas = math.sqrt(position), math.sqrt(position), math.sqrt(heading)
        shift = Pose(*(sigma * part / steps for sigma, part in zip(sigmas, slip.tolist(), strict=True)))
        truth, per_step = self._truth, (shift.x, shift.y, shift.theta)
        solid, radius = self._solid.at(truth.x, truth.y), float(self._radius_m)
        found, self._collided = _driven_among(
            (truth.x, truth.y, truth.theta), (v_true, w_true, dt / steps), steps, per_step, solid, radius
        )
        self._truth = Pose(*found)

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
        stamps_s = 1e-9 * self._period_ns * np.arange(1 - len(self._past), 1, dtype=np.float64)
        poses = interpolated(stamps_s, np.array([pose.array() for pose in self._past]), self._times_s)
        x, y, theta = self._config.laser.mount
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        return np.column_stack([poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y, poses[:, 2] + theta])
