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
PartName = str | Callable[..., Any]
"""a name, or the class or function itself"""


class _EstimateParts(TypedDict, total=False):
    """Parts that every call takes."""

    estimator: PartName
    front_end: PartName
    extractor: PartName
    place_search: PartName


class _DrivingParts(TypedDict, total=False):
    """Parts of a robot that is driven."""

    planner: PartName
    explorer: PartName


class _EstimateFields(TypedDict, total=False):
    """Fields of the estimate alone, which every call takes."""

    estimator_options: Table
    front_end_options: Table
    extractor_options: Table
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

    planner_options: Table
    explorer_options: Table
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


class Fields(_WorldFields, _EstimateParts, _DrivingParts, total=False):
    """Fields of `ss.preset`: the whole configuration."""

    scene: str
    preset: str
    seed: int


class _PriorMapFields(TypedDict, total=False):
    """The start in a prior map."""

    pose: Sequence[float]
    pose_sigma: Sequence[float]
    lost: bool


class RunFields(_WorldFields, _EstimateParts, _DrivingParts, _PriorMapFields, total=False):
    """Fields of `ss.run`."""

    preset: str
    seed: int


class MergeFields(_EstimateFields, _EstimateParts, total=False):
    """Fields of `ss.merge_runs`."""

    seed: int


class ReplayFields(MergeFields, _PriorMapFields, total=False):
    """Fields of `ss.replay`."""

    preset: str


class CampaignFields(_WorldFields, total=False):
    """Fields of `ss.campaign`: one value or several of what it compares."""

    estimator: PartName | Sequence[PartName]
    front_end: PartName | Sequence[PartName]
    extractor: PartName | Sequence[PartName]
    place_search: PartName | Sequence[PartName]
    planner: PartName | Sequence[PartName]
    explorer: PartName | Sequence[PartName]
    preset: str | Sequence[str]
