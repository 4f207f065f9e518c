"""The configuration tree, structured like the pipeline; the docstring of a field is its text in the help."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from sixthsense.config.errors import InputError
from sixthsense.config.names import ESTIMATORS, FILTERS, KEEP_POSES, PLANNERS
from sixthsense.config.section import Count, Range, Section, shown
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


@dataclass(frozen=True)
class Config(Section):
    """All settings of a run: the same configuration and source give the same run, bit for bit."""

    scene: str = "apartment"
    """Shipped scene, or a file: .toml, map_server .yaml, .scn."""
    preset: str = "default"
    """Set of values: default, worn, noiseless, report, log, mrclam or victoria. A file and options override it."""
    estimator: Annotated[str, ESTIMATORS] = "ekf-invariant"
    """Back end: ekf-invariant, ekf-fej, ekf-oc, ekf or isam2. The first three are filters that stay consistent when
    the robot turns, ekf is the report's filter, isam2 a smoother."""
    front_end: Literal["landmarks", "scan-matching"] = "landmarks"
    """What the estimator is given: landmarks or scan-matching. landmarks: observations of walls and points;
    scan-matching: relative poses of keyframes, for an estimator that keeps all poses, isam2. Logs with scans: isam2
    and scan-matching, unless an estimator is named."""
    calibrate_wheels: bool = False
    """Estimate the wheels' systematic errors with the pose. For ekf-invariant and isam2, with both front ends; their
    prior is in assumed.wheels."""
    calibrate_sensor: bool = False
    """Estimate the mount and lens of a camera with the pose. For ekf-invariant and isam2, with logs of observations
    that name their landmark; `core/sensor.py` has the prior."""
    no_odometry: bool = False
    """Use scans alone: the last velocity predicts. A scan's motion is found by scan matching; wheels that are there are
    ignored."""
    planner: Annotated[str, PLANNERS] = "astar"
    """Path planner: astar or rrtstar. astar: shortest over the grid's cells; rrtstar: sampled in the plane."""
    task: Literal["explore", "goal", "tour"] = "explore"
    """Task: explore, goal or tour. explore: see all of the region, then drive home; goal: drive to a
    goal; tour: drive to a list of goals, again and again until max-time, or once without it."""
    goal: tuple[float, float] | None = None
    """x y, world frame, m; none: the scene's."""
    tour: tuple[tuple[float, float], ...] | None = None
    """x y of each goal, world frame, m; none: the scene's."""
    start: tuple[float, float, float] | None = None
    """x y theta, world frame, m and rad; none: the scene's."""
    region: tuple[float, float, float, float] | None = None
    """x0 y0 x1 y1 of the region to see, m; none: the scene's."""
    seed: Count = 0
    """Seed of all randomness."""
    max_time: Annotated[float, Range(0.0, 1e9, open_low=True)] | None = None
    """Time limit by the clock of the source, s. None: the run ends when the task is over."""
    people: bool | None = None
    """People may walk by: what moves is no evidence. Neither the map nor scan matching counts it, and the robot keeps
    its distance and its patience. None: where people walk in the simulated world."""
    map_unknown: Literal["wall", "free"] = "wall"
    """Unknown cells of a map_server map: wall or free. Free cells are transparent."""
    robot: RobotConfig = field(default_factory=RobotConfig)
    laser: LaserConfig = field(default_factory=LaserConfig)
    world: WorldConfig = field(default_factory=WorldConfig)
    assumed: AssumedConfig = field(default_factory=AssumedConfig)
    keyframes: KeyframeConfig = field(default_factory=KeyframeConfig)
    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    association: AssociationConfig = field(default_factory=AssociationConfig)
    scans: ScansConfig = field(default_factory=ScansConfig)
    isam2: ISAM2Config = field(default_factory=ISAM2Config)
    grid: GridConfig = field(default_factory=GridConfig)
    rrtstar: RRTStarConfig = field(default_factory=RRTStarConfig)
    follow: FollowConfig = field(default_factory=FollowConfig)
    explore: ExploreConfig = field(default_factory=ExploreConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)

    def with_implied(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """What follows from named fields.

        A goal replaces a tour, and a tour a goal. A named estimator gets a front end that it can use, and a named front
        end an estimator that can use it. Without odometry the front end is scan matching.
        """
        table = dict(table)
        for name, other in (("goal", "tour"), ("tour", "goal")):
            if table.get(name) is not None and other not in table:
                table[other] = None
        if table.get("no_odometry") is True:
            table = {"front_end": "scan-matching", **table}
        estimator, front_end = table.get("estimator"), table.get("front_end")
        if estimator is not None and front_end is None and self.front_end == "scan-matching" and estimator != "isam2":
            return {**table, "front_end": "landmarks"}
        if front_end == "scan-matching" and estimator is None and self.estimator in FILTERS:
            return {**table, "estimator": "isam2"}
        return table

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.goal is not None and self.tour is not None:
            raise InputError("goal", "found beside a tour", "one of the two")
        if self.front_end == "scan-matching" and self.estimator in FILTERS:
            raise InputError("front_end", f"found scan-matching with estimator {self.estimator}", KEEP_POSES)
        if self.no_odometry and (self.front_end != "scan-matching" or self.calibrate_wheels):
            found = "calibrate_wheels" if self.calibrate_wheels else f"front_end {self.front_end}"
            raise InputError("no_odometry", f"found true with {found}", "with front_end scan-matching alone")
        between = self.laser.period_ticks * self.robot.control_period_s
        if self.laser.sweep_s > between * (1.0 + 1e-9):
            raise InputError(
                "laser.sweep_s", f"found {self.laser.sweep_s:g}", f"at most {between:g}, the time between two scans"
            )


def task_of(given: Mapping[str, Any]) -> dict[str, str]:
    """The task that a goal or a tour among the `given` fields sets, as a table; empty without one.

    Raises InputError for a goal or a tour with another task.
    """
    for task in ("goal", "tour"):
        if given.get(task) is None:
            continue
        named = given.get("task", task)
        if named != task:
            found = named if isinstance(named, str) else shown(named)
            raise InputError(task, f"found with `task` {found}", f"with `task` {task}")
        return {"task": task}
    return {}
