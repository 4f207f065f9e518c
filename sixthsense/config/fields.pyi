"""The fields that `ss.run` and its kin take by name; written by tests/config/rewrite_fields.py."""
# ruff: noqa: F403, F405

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict

from sixthsense.config.sections import *

Table = Mapping[str, Any]
PartName = str | Callable[..., Any]

class Fields(TypedDict, total=False):
    scene: str
    preset: str
    estimator: PartName
    front_end: PartName
    extractor: PartName
    place_search: PartName
    calibrate_wheels: bool
    calibrate_sensor: bool
    no_odometry: bool
    time_offset: float | None
    planner: PartName
    explorer: PartName
    task: Literal["explore", "goal", "tour"]
    goal: Sequence[float] | None
    tour: Sequence[Sequence[float]] | None
    start: Sequence[float] | None
    region: Sequence[float] | None
    seed: int
    max_time: float | None
    people: bool | None
    map_unknown: Literal["wall", "free"]
    estimator_options: Table
    front_end_options: Table
    extractor_options: Table
    place_search_options: Table
    planner_options: Table
    explorer_options: Table
    robot: RobotConfig | Table
    laser: LaserConfig | Table
    world: WorldConfig | Table
    assumed: AssumedConfig | Table
    keyframes: KeyframeConfig | Table
    features: FeaturesConfig | Table
    association: AssociationConfig | Table
    scans: ScansConfig | Table
    isam2: ISAM2Config | Table
    grid: GridConfig | Table
    rrtstar: RRTStarConfig | Table
    follow: FollowConfig | Table
    explore: ExploreConfig | Table
    safety: SafetyConfig | Table

class RunFields(TypedDict, total=False):
    preset: str
    estimator: PartName
    front_end: PartName
    extractor: PartName
    place_search: PartName
    calibrate_wheels: bool
    calibrate_sensor: bool
    no_odometry: bool
    time_offset: float | None
    planner: PartName
    explorer: PartName
    task: Literal["explore", "goal", "tour"]
    goal: Sequence[float] | None
    tour: Sequence[Sequence[float]] | None
    start: Sequence[float] | None
    region: Sequence[float] | None
    seed: int
    max_time: float | None
    people: bool | None
    map_unknown: Literal["wall", "free"]
    estimator_options: Table
    front_end_options: Table
    extractor_options: Table
    place_search_options: Table
    planner_options: Table
    explorer_options: Table
    robot: RobotConfig | Table
    laser: LaserConfig | Table
    world: WorldConfig | Table
    assumed: AssumedConfig | Table
    keyframes: KeyframeConfig | Table
    features: FeaturesConfig | Table
    association: AssociationConfig | Table
    scans: ScansConfig | Table
    isam2: ISAM2Config | Table
    grid: GridConfig | Table
    rrtstar: RRTStarConfig | Table
    follow: FollowConfig | Table
    explore: ExploreConfig | Table
    safety: SafetyConfig | Table
    pose: Sequence[float]
    pose_sigma: Sequence[float]
    lost: bool

class MergeFields(TypedDict, total=False):
    estimator: PartName
    front_end: PartName
    extractor: PartName
    place_search: PartName
    calibrate_wheels: bool
    calibrate_sensor: bool
    no_odometry: bool
    time_offset: float | None
    seed: int
    max_time: float | None
    people: bool | None
    estimator_options: Table
    front_end_options: Table
    extractor_options: Table
    place_search_options: Table
    laser: LaserConfig | Table
    assumed: AssumedConfig | Table
    keyframes: KeyframeConfig | Table
    features: FeaturesConfig | Table
    association: AssociationConfig | Table
    scans: ScansConfig | Table
    isam2: ISAM2Config | Table
    grid: GridConfig | Table
    safety: SafetyConfig | Table

class ReplayFields(TypedDict, total=False):
    preset: str
    estimator: PartName
    front_end: PartName
    extractor: PartName
    place_search: PartName
    calibrate_wheels: bool
    calibrate_sensor: bool
    no_odometry: bool
    time_offset: float | None
    seed: int
    max_time: float | None
    people: bool | None
    estimator_options: Table
    front_end_options: Table
    extractor_options: Table
    place_search_options: Table
    laser: LaserConfig | Table
    assumed: AssumedConfig | Table
    keyframes: KeyframeConfig | Table
    features: FeaturesConfig | Table
    association: AssociationConfig | Table
    scans: ScansConfig | Table
    isam2: ISAM2Config | Table
    grid: GridConfig | Table
    safety: SafetyConfig | Table
    pose: Sequence[float]
    pose_sigma: Sequence[float]
    lost: bool

class CampaignFields(TypedDict, total=False):
    preset: str | Sequence[str]
    estimator: PartName | Sequence[PartName]
    front_end: PartName | Sequence[PartName]
    extractor: PartName | Sequence[PartName]
    place_search: PartName | Sequence[PartName]
    calibrate_wheels: bool
    calibrate_sensor: bool
    no_odometry: bool
    time_offset: float | None
    planner: PartName | Sequence[PartName]
    explorer: PartName | Sequence[PartName]
    task: Literal["explore", "goal", "tour"]
    goal: Sequence[float] | None
    tour: Sequence[Sequence[float]] | None
    start: Sequence[float] | None
    region: Sequence[float] | None
    max_time: float | None
    people: bool | None
    map_unknown: Literal["wall", "free"]
    estimator_options: Table
    front_end_options: Table
    extractor_options: Table
    place_search_options: Table
    planner_options: Table
    explorer_options: Table
    robot: RobotConfig | Table
    laser: LaserConfig | Table
    world: WorldConfig | Table
    assumed: AssumedConfig | Table
    keyframes: KeyframeConfig | Table
    features: FeaturesConfig | Table
    association: AssociationConfig | Table
    scans: ScansConfig | Table
    isam2: ISAM2Config | Table
    grid: GridConfig | Table
    rrtstar: RRTStarConfig | Table
    follow: FollowConfig | Table
    explore: ExploreConfig | Table
    safety: SafetyConfig | Table
