"""The simulated drive in kernels: true motion with its noise, collisions, and odometry, tick by tick."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.core.odometry_kernels import Slip, slipped
from sixthsense.core.pose_kernels import Triple, composed, driven, wrapped

DRAWS = 5
"""of noise per control tick: of speed and turn rate, and of slip in x, y and heading"""


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
        return Drive(
            float(robot.speed),
            float(robot.turn_rate),
            period_ns,
            max(1, math.ceil(period_ns * 1e-9 / robot.integration_step_s - 1e-9)),
            float(world.motion.speed),
            float(world.motion.turn_rate),
            float(world.wheel_scale_error),
            float(world.drift_rad_per_m),
            Slip.of(world.motion),
            float(radius_m),
        )


class Driving(NamedTuple):
    """Where the robot is, and what it meets until the next scan."""

    truth: Triple
    """`T_world_robot`"""
    odometry: Triple
    """`T_odom_robot`"""
    draws: Array
    """(K, DRAWS) of the noise of the next ticks"""
    solid: Array
    """(M, 4) all segments that the robot can come to, which it cannot pass"""


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
