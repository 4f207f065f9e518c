"""The sections of the configuration as typed dictionaries: `fields.py` says what they are for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypedDict


class RobotFields(TypedDict, total=False):
    """Fields of `RobotConfig`."""

    speed: float
    turn_rate: float
    deceleration: float
    radius: float
    control_period_s: float
    integration_step_s: float


class LaserFields(TypedDict, total=False):
    """Fields of `LaserConfig`."""

    beams: int
    fov: float
    max_range: float
    mount: Sequence[float]
    period_ticks: int
    sweep_s: float


class MotionNoiseFields(TypedDict, total=False):
    """Fields of `MotionNoise`."""

    distribution: Literal["gaussian", "uniform"]
    speed: float
    turn_rate: float
    slip_position_per_sqrt_m: float
    slip_position_per_sqrt_rad: float
    slip_heading_per_sqrt_m: float
    slip_heading_per_sqrt_rad: float


class LaserNoiseFields(TypedDict, total=False):
    """Fields of `LaserNoise`."""

    distribution: Literal["gaussian", "uniform"]
    range_m: float
    bearing_rad: float


class WorldFields(TypedDict, total=False):
    """Fields of `WorldConfig`."""

    motion: MotionNoiseFields
    laser: LaserNoiseFields
    wheel_scale_error: float
    drift_rad_per_m: float
    walkers: int
    walkers_blind: bool


class WheelsFields(TypedDict, total=False):
    """Fields of `WheelsConfig`."""

    scale_sigma: float
    track_sigma: float
    drift_sigma_rad_per_m: float
    latency_sigma_s: float
    jitter_sigma_s: float
    curve_loss_sigma_m_per_rad: float


class SensorFields(TypedDict, total=False):
    """Fields of `SensorConfig`."""

    scale_sigma: float
    yaw_sigma_rad: float
    forward_sigma_m: float
    bearing_scale_sigma: float


class AssumedFields(TypedDict, total=False):
    """Fields of `AssumedConfig`."""

    motion: MotionNoiseFields
    laser: LaserNoiseFields
    wheel_scale_error: float
    drift_rad_per_m: float
    landmark_floor_m: float
    wall_floor_rad: float
    floor_m: float
    floor_rad: float
    wheels: WheelsFields
    sensor: SensorFields


class KeyframeFields(TypedDict, total=False):
    """Fields of `KeyframeConfig`."""

    distance_m: float
    turn_rad: float


class PartitionFields(TypedDict, total=False):
    """Fields of `PartitionConfig`."""

    method: Literal["adaptive", "fixed"]
    epsilon_m: float
    incidence_rad: float


class SplitFields(TypedDict, total=False):
    """Fields of `SplitConfig`."""

    enabled: bool
    epsilon_m: float


class LinesFields(TypedDict, total=False):
    """Fields of `LinesConfig`."""

    ransac: bool
    ransac_threshold_m: float
    ransac_iterations: int
    least_squares: bool
    min_points: int
    min_length_m: float
    cut_false_alarm: float


class PointsFields(TypedDict, total=False):
    """Fields of `PointsConfig`."""

    corners: bool
    ends: bool
    max_gap_m: float
    min_points: int
    max_sigma_m: float


class WallsFields(TypedDict, total=False):
    """Fields of `WallsConfig`."""

    max_sigma_rad: float


class FeaturesFields(TypedDict, total=False):
    """Fields of `FeaturesConfig`."""

    landmarks: Literal["corners", "walls", "both"]
    deskew: bool
    partition: PartitionFields
    split: SplitFields
    lines: LinesFields
    points: PointsFields
    walls: WallsFields


class AssociationFields(TypedDict, total=False):
    """Fields of `AssociationConfig`."""

    match_gate: float
    new_gate: float
    pre_gate_m: float
    new_separation_m: float
    known_probability: float
    proposed_by: Literal["estimate", "scan-matching"]
    cull_period: int
    cull_below: int


class ScansFields(TypedDict, total=False):
    """Fields of `ScansConfig`."""

    max_range_m: float
    loop_closures: bool
    min_score: float
    final_pass: bool


class ISAM2Fields(TypedDict, total=False):
    """Fields of `ISAM2Config`."""

    relinearize_threshold: float
    iterations: int
    robust: Literal["none", "huber", "cauchy"]
    undo_probability: float
    least_gain: float


class GridFields(TypedDict, total=False):
    """Fields of `GridConfig`."""

    cell_m: float
    walls: bool
    min_hits: int
    passes_per_hit: float
    max_hits: int
    no_return_passes: bool
    clearance_m: float


class RRTStarFields(TypedDict, total=False):
    """Fields of `RRTStarConfig`."""

    informed: bool
    iterations: int
    range_m: float
    goal_bias: float


class FollowFields(TypedDict, total=False):
    """Fields of `FollowConfig`."""

    heading_slack_rad: float
    distance_slack_m: float
    goal_slack_m: float
    shortcut: bool


class ExploreFields(TypedDict, total=False):
    """Fields of `ExploreConfig`."""

    method: Literal["frontier", "random"]
    return_home: bool
    tries: int
    dust: float
    margin_m: float
    least_area_m2: float
    loop_closure: bool
    loop_closure_sigma_m: float


class SafetyFields(TypedDict, total=False):
    """Fields of `SafetyConfig`."""

    probability: float
    max_margin_m: float
    detour: float
    guard: bool
    buffer_m: float
    body_m: float
    creep: float
