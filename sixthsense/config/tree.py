"""The configuration tree, structured like the pipeline; the docstring of a field is its text in the help."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

from sixthsense.config.errors import InputError, PartError, nearest, reason_of
from sixthsense.config.parts import (
    ESTIMATORS,
    EXPLORERS,
    EXTRACTORS,
    FILTERS,
    FRONT_ENDS,
    KEEP_POSES,
    KINDS,
    PLACE_SEARCHES,
    PLANNERS,
    PartOptions,
    Parts,
    options_class,
)
from sixthsense.config.section import Count, Range, Section, checked, hints_of, shown
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
    """Back end: ekf-invariant, ekf-fej, ekf-oc, ekf, isam2, or your own. The first three are filters that stay
    consistent when the robot turns, ekf is the report's filter, isam2 a smoother; `sixthsense parts` says how one of
    yours is named."""
    front_end: Annotated[str, FRONT_ENDS] = "landmarks"
    """What the estimator is given: landmarks, scan-matching, or your own. landmarks: observations of walls and points;
    scan-matching: relative poses of keyframes, for an estimator that keeps all poses, isam2. Logs with scans: isam2
    and scan-matching, unless an estimator is named."""
    extractor: Annotated[str, EXTRACTORS] = "lines"
    """What finds landmarks in a scan: lines, or your own. lines: walls, corners and free ends; `features` has its
    options."""
    place_search: Annotated[str, PLACE_SEARCHES] = "branch-and-bound"
    """What proposes old places that the robot may be at again: branch-and-bound, or your own. With front_end
    scan-matching; what is proposed is judged and verified in any case."""
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
    """Path planner: astar, rrtstar, or your own. astar: shortest over the grid's cells; rrtstar: sampled in the
    plane."""
    explorer: Annotated[str, EXPLORERS] = "frontier"
    """What chooses the next view of an exploration: frontier, random, or your own. frontier: the first viewpoint of a
    short tour through all of them and home; random: places drawn in the largest unseen area, the report's idea."""
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
    estimator_options: PartOptions = field(default_factory=PartOptions)
    """Options of an estimator that is not shipped, by name."""
    front_end_options: PartOptions = field(default_factory=PartOptions)
    """Options of a front end that is not shipped, by name."""
    extractor_options: PartOptions = field(default_factory=PartOptions)
    """Options of an extractor that is not shipped, by name."""
    place_search_options: PartOptions = field(default_factory=PartOptions)
    """Options of a place search that is not shipped, by name."""
    planner_options: PartOptions = field(default_factory=PartOptions)
    """Options of a planner that is not shipped, by name."""
    explorer_options: PartOptions = field(default_factory=PartOptions)
    """Options of an explorer that is not shipped, by name."""
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
        for parts in KINDS:
            options = f"{parts.kind}_options"
            is_same = parts.kind not in table or parts.name_of(table[parts.kind]) == getattr(self, parts.kind)
            if not is_same and options not in table and getattr(self, options):
                table[options] = {}  # those were of another part
            elif is_same and isinstance(table.get(options), Mapping):
                table[options] = {**getattr(self, options), **table[options]}
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


class Part(NamedTuple):
    """What a run is made with in one place."""

    name: str
    """kind and name"""
    factory: Any
    """the class or function that makes it"""
    options: Any = None
    """an object of its `Options`"""
    is_shipped: bool = True

    def make(self, *args: Any) -> Any:
        """Make it; its options are the last argument, if it has any. Raises PartError for one that cannot be made."""
        options = () if options_class(self.factory) is None else (self.options,)
        if self.is_shipped:
            return self.factory(*args, *options)
        try:
            return self.factory(*args, *options)
        except InputError:
            raise
        except Exception as error:
            found = f"cannot be made, it raised {type(error).__name__} ({reason_of(error)})"
            raise PartError(self.name, found) from error


def part_of(config: Config, parts: Parts) -> Part:
    """The configured part of a kind; InputError for one that cannot be imported, and for options that it has not."""
    name, given = getattr(config, parts.kind), getattr(config, f"{parts.kind}_options")
    factory, section = parts.load(name), parts.sections.get(name)
    if section is None:
        options = part_options(parts.kind, factory, given)
        return Part(f"{parts.kind} {name}", factory, options, name in parts.shipped)
    if given:
        raise InputError(f"{parts.kind}_options", f"found {', '.join(given)} for {name}", f"the section {section}")
    return Part(f"{parts.kind} {name}", factory, getattr(config, section))


def check_parts(config: Config) -> None:
    """Raise InputError for a part that cannot be imported, and for options that it does not have."""
    for parts in KINDS:
        if getattr(config, parts.kind) not in parts.shipped or getattr(config, f"{parts.kind}_options"):
            part_of(config, parts)


def default_options(factory: Any) -> Any:
    """An object of a part's `Options` without arguments; None of a part without."""
    cls = options_class(factory)
    return None if cls is None else cls()


def make_part(parts: Parts, part: Any, *args: Any, options: Any = None) -> Any:
    """A part of a kind, by its name or its class, made with arguments; `options` are by default its own.

    Raises InputError that lists the known names for any other.
    """
    factory = parts.load(part) if isinstance(part, str) else part
    return Part(parts.kind, factory, options or default_options(factory)).make(*args)


def part_options(kind: str, factory: Any, given: Mapping[str, Any]) -> Any:
    """The options of a part with the values that are given, checked by the annotations of its dataclass."""
    cls, where = options_class(factory), f"{kind}_options"
    hints = {} if cls is None else hints_of(cls)
    for name in given:
        if name not in hints:
            raise InputError(f"{where}.{name}", "no such option", ", ".join(hints) or "none", nearest(name, hints))
    return None if cls is None else cls(**{k: checked(f"{where}.{k}", hints[k], value) for k, value in given.items()})


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
