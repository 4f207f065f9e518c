"""The fields that `ss.run` and its kin take by name: what a type checker accepts and an editor completes.

A section is given as an object or as a table; what it states replaces the values of the preset. A test compares the
names and types with those of `Config`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict

from sixthsense.config.sections import (
    AssociationConfig,
    AssumedConfig,
    ExploreConfig,
    FeaturesConfig,
    FollowConfig,
    GridConfig,
    ISAM2Config,
    KeyframeConfig,
    LaserConfig,
    RobotConfig,
    RRTStarConfig,
    SafetyConfig,
    ScansConfig,
    WorldConfig,
)

Table = Mapping[str, Any]


class _EstimateFields(TypedDict, total=False):
    """Fields of the estimate alone, which every call takes."""

    front_end: str | Callable[..., Any]
    front_end_options: Table
    extractor: str | Callable[..., Any]
    extractor_options: Table
    place_search: str | Callable[..., Any]
    place_search_options: Table
    calibrate_wheels: bool
    calibrate_sensor: bool
    no_odometry: bool
    people: bool | None
    max_time: float | None
    laser: LaserConfig | Table
    assumed: AssumedConfig | Table
    keyframes: KeyframeConfig | Table
    features: FeaturesConfig | Table
    association: AssociationConfig | Table
    scans: ScansConfig | Table
    isam2: ISAM2Config | Table
    grid: GridConfig | Table
    safety: SafetyConfig | Table


class _WorldFields(_EstimateFields, total=False):
    """Fields of a robot that is simulated or driven as well."""

    task: Literal["explore", "goal", "tour"]
    goal: Sequence[float] | None
    tour: Sequence[Sequence[float]] | None
    start: Sequence[float] | None
    region: Sequence[float] | None
    map_unknown: Literal["wall", "free"]
    robot: RobotConfig | Table
    world: WorldConfig | Table
    rrtstar: RRTStarConfig | Table
    follow: FollowConfig | Table
    explore: ExploreConfig | Table


class Fields(_WorldFields, total=False):
    """Fields of `ss.preset`: the whole configuration."""

    scene: str
    preset: str
    estimator: str | Callable[..., Any]
    estimator_options: Table
    planner: str | Callable[..., Any]
    planner_options: Table
    explorer: str | Callable[..., Any]
    explorer_options: Table
    seed: int


class _PriorMapFields(TypedDict, total=False):
    """The start in a prior map."""

    pose: Sequence[float]
    pose_sigma: Sequence[float]
    lost: bool


class RunFields(_WorldFields, _PriorMapFields, total=False):
    """Fields of `ss.run`."""

    preset: str
    estimator: str | Callable[..., Any]
    estimator_options: Table
    planner: str | Callable[..., Any]
    planner_options: Table
    explorer: str | Callable[..., Any]
    explorer_options: Table
    seed: int


class MergeFields(_EstimateFields, total=False):
    """Fields of `ss.merge_runs`."""

    estimator: str | Callable[..., Any]
    estimator_options: Table
    seed: int


class ReplayFields(MergeFields, _PriorMapFields, total=False):
    """Fields of `ss.replay`."""

    preset: str


class CampaignFields(_WorldFields, total=False):
    """Fields of `ss.campaign`: one value or several of what it compares."""

    estimator: str | Callable[..., Any] | Sequence[str | Callable[..., Any]]
    estimator_options: Table
    preset: str | Sequence[str]
    planner: str | Callable[..., Any] | Sequence[str | Callable[..., Any]]
    planner_options: Table
    explorer: str | Callable[..., Any]
    explorer_options: Table
