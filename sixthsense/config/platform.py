"""Configuration of the robot, its laser, and their noise, simulated and assumed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

from sixthsense.config.section import (
    AngularNoise,
    Distribution,
    Noise,
    NonNegative,
    Positive,
    PositiveCount,
    Range,
    Section,
)


@dataclass(frozen=True)
class MotionNoise(Section):
    """Noise of the drive: multiplicative on each control tick, plus slip that grows with distance and turn."""

    distribution: Distribution = "gaussian"
    """Of the multiplicative part."""
    speed: Noise = 0.1
    """Of v, as a fraction of it: sigma, or the half-width if uniform."""
    turn_rate: Noise = 0.1
    """Of omega, as a fraction of it: sigma, or the half-width if uniform."""
    slip_position_per_sqrt_m: Noise = 5e-3
    """Sigma of position slip, m / sqrt(m)."""
    slip_position_per_sqrt_rad: Noise = 2e-3
    """Sigma of position slip, m / sqrt(rad)."""
    slip_heading_per_sqrt_m: Annotated[float, Range(0.0, 100.0, unit="rad/√m")] = math.radians(0.5)
    """Sigma of heading slip, rad / sqrt(m)."""
    slip_heading_per_sqrt_rad: Annotated[float, Range(0.0, 100.0, unit="rad/√rad")] = math.radians(0.5)
    """Sigma of heading slip, rad / sqrt(rad)."""


@dataclass(frozen=True)
class LaserNoise(Section):
    """Additive noise of the laser."""

    distribution: Distribution = "gaussian"
    """Of both parts."""
    range_m: Noise = 0.01
    """Of a range: sigma, or the half-width if uniform."""
    bearing_rad: AngularNoise = 0.0
    """Of a beam's direction: sigma, or the half-width if uniform."""


@dataclass(frozen=True)
class WorldConfig(Section):
    """Errors of the simulated robot, and people in the building; the estimators never see either."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    laser: LaserNoise = field(default_factory=LaserNoise)
    wheel_scale_error: Annotated[float, Range(-0.5, 0.5)] = 0.0
    """True distance and turn are (1 + this) times those the wheels report."""
    drift_rad_per_m: Annotated[float, Range(-10.0, 10.0, unit="rad/m")] = 0.0
    """Turn that an unequal pair of wheels adds per metre driven."""
    walkers: Annotated[int, Range(0, 1000)] = 0
    """People who walk from room to room, besides those of the scene."""
    walkers_blind: bool = False
    """Whether people do not stop for the robot."""


@dataclass(frozen=True)
class WheelsConfig(Section):
    """Sigmas of the wheels' parameters where these are estimated, about the assumed values; 0: exactly known."""

    latency_sigma_s: Noise = 0.0
    """Of the age of odometry at its stamp."""
    jitter_sigma_s: Noise = 0.0
    """Of the age's variation, from one change of the velocity to the next."""
    curve_loss_sigma_m_per_rad: Annotated[float, Range(0.0, 100.0, unit="m/rad")] = 0.0
    """Of the distance that curves are shorter than reported, per radian turned."""


@dataclass(frozen=True)
class AssumedConfig(Section):
    """Noise that the estimators assume; by default that of the simulator, a mismatch is an experiment."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    laser: LaserNoise = field(default_factory=LaserNoise)
    wheel_scale_error: Annotated[float, Range(-0.5, 0.5)] = 0.0
    """True distance and turn are (1 + this) times those the wheels report; corrected before use."""
    drift_rad_per_m: Annotated[float, Range(-10.0, 10.0, unit="rad/m")] = 0.0
    """Turn that an unequal pair of wheels adds per metre driven; corrected before use."""
    landmark_floor_m: Noise = 0.0
    """Sigma added to every observation, for the deviation of real walls from straight lines."""
    wall_floor_rad: AngularNoise = 0.0
    """The same for the direction of a wall."""
    floor_m: Noise = 1e-4
    """Sigma of position added over the motion between two keyframes, so that the covariance has full rank."""
    floor_rad: AngularNoise = 1e-4
    """The same for the heading."""
    wheels: WheelsConfig = field(default_factory=WheelsConfig)


DEFAULT_ROBOT_RADIUS_M = 0.2
"""Where neither the configuration nor a scene states a radius."""


@dataclass(frozen=True)
class RobotConfig(Section):
    """The differential drive."""

    speed: Positive = 0.5
    """Top speed, m/s."""
    turn_rate: Positive = 1.0
    """Top turn rate, rad/s."""
    deceleration: Positive = 1.0
    """Of braking, m/s^2, as the guard assumes it; the simulated robot stops at once."""
    radius: NonNegative = 0.0
    """Of the disc, m; 0: the scene's."""
    control_period_s: Annotated[float, Range(1e-4, 10.0)] = 0.02
    """Time between two control ticks."""


@dataclass(frozen=True)
class LaserConfig(Section):
    """The scanner, its mount and its rate."""

    beams: Annotated[int, Range(2, 100_000)] = 360
    """Beams per scan; a full circle is closed, the first beam follows the last."""
    fov: Annotated[float, Range(0.0, 2 * math.pi, open_low=True, unit="rad")] = 2 * math.pi
    """Field of view, rad, centred on the mount's x axis."""
    max_range: Annotated[float, Range(0.0, 1000.0, open_low=True)] = 10.0
    """m; a beam that hits nothing nearer returns inf."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of the laser in the robot's frame: x y theta, m and rad."""
    period_ticks: PositiveCount = 5
    """Control ticks per scan."""
    sweep_s: Annotated[float, Range(0.0, 1.0)] = 0.0
    """Duration of one scan, at most the time between two; it ends at the scan's stamp. 0: an instant."""
