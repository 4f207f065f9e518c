"""The configuration tree, structured like the pipeline; the docstring of a field is its text in the help."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import traceback
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError, model_validator

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
    Parts,
    options_class,
)
from sixthsense.config.section import Count, Section, input_error, merge, shown
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


def _table(value: Any) -> Any:
    """The options of a part as a table; they may be given as an object of its `Options`."""
    options = dataclasses.asdict(value) if dataclasses.is_dataclass(value) and not isinstance(value, type) else value
    return {str(k).replace("-", "_"): one for k, one in options.items()} if isinstance(options, Mapping) else options


PartOptions = Annotated[dict[str, Any], BeforeValidator(_table)]


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
    """Estimate the lens of a camera with the pose. For ekf-invariant and isam2, with logs of observations
    that name their landmark; `core/sensor.py` has the prior."""
    no_odometry: bool = False
    """Use scans alone: the last velocity predicts. A scan's motion is found by scan matching; wheels that are there are
    ignored."""
    time_offset: float | None = None
    """Time by which the stamps of a log's odometry are early beside those of its scans, s. None: it is looked for, by
    the turns that both see."""
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
    tour: Annotated[tuple[tuple[float, float], ...], Field(min_length=1)] | None = None
    """x y of each goal, world frame, m; none: the scene's."""
    start: tuple[float, float, float] | None = None
    """x y theta, world frame, m and rad; none: the scene's."""
    region: tuple[float, float, float, float] | None = None
    """x0 y0 x1 y1 of the region to see, m; none: the scene's."""
    seed: Count = 0
    """Seed of all randomness."""
    max_time: Annotated[float, Field(gt=0.0, le=1e9)] | None = None
    """Time limit by the clock of the source, s. None: the run ends when the task is over."""
    people: bool | None = None
    """People may walk by: what moves is no evidence. Neither the map nor scan matching counts it, and the robot keeps
    its distance and its patience. None: where people walk in the simulated world."""
    map_unknown: Literal["wall", "free"] = "wall"
    """Unknown cells of a map_server map: wall or free. Free cells are transparent."""
    estimator_options: PartOptions = Field(default_factory=dict)
    """Options of an estimator that is not shipped, by name."""
    front_end_options: PartOptions = Field(default_factory=dict)
    """Options of a front end that is not shipped, by name."""
    extractor_options: PartOptions = Field(default_factory=dict)
    """Options of an extractor that is not shipped, by name."""
    place_search_options: PartOptions = Field(default_factory=dict)
    """Options of a place search that is not shipped, by name."""
    planner_options: PartOptions = Field(default_factory=dict)
    """Options of a planner that is not shipped, by name."""
    explorer_options: PartOptions = Field(default_factory=dict)
    """Options of an explorer that is not shipped, by name."""
    robot: RobotConfig = RobotConfig()
    laser: LaserConfig = LaserConfig()
    world: WorldConfig = WorldConfig()
    assumed: AssumedConfig = AssumedConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    features: FeaturesConfig = FeaturesConfig()
    association: AssociationConfig = AssociationConfig()
    scans: ScansConfig = ScansConfig()
    isam2: ISAM2Config = ISAM2Config()
    grid: GridConfig = GridConfig()
    rrtstar: RRTStarConfig = RRTStarConfig()
    follow: FollowConfig = FollowConfig()
    explore: ExploreConfig = ExploreConfig()
    safety: SafetyConfig = SafetyConfig()

    def with_implied(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """What follows from named fields.

        A goal replaces a tour, and a tour a goal. A named estimator gets a front end that it can use, and a named front
        end an estimator that can use it. Without odometry the front end is scan matching.
        """
        table = dict(table)
        for parts in KINDS:
            options, part = f"{parts.kind}_options", getattr(self, parts.kind)
            if parts.name_of(table.get(parts.kind, part)) != part:
                table.setdefault(options, {})  # those were of another part
            elif isinstance(table.get(options), Mapping):
                table[options] = {**getattr(self, options), **table[options]}
        for name, other in (("goal", "tour"), ("tour", "goal")):
            if table.get(name) is not None:
                table.setdefault(other, None)
        if table.get("no_odometry") is True:
            table = {"front_end": "scan-matching", **table}
        estimator, front_end = table.get("estimator"), table.get("front_end")
        if estimator is not None and front_end is None and self.front_end == "scan-matching" and estimator != "isam2":
            return {**table, "front_end": "landmarks"}
        if front_end == "scan-matching" and estimator is None and self.estimator in FILTERS:
            return {**table, "estimator": "isam2"}
        return table

    @model_validator(mode="after")
    def _together(self) -> Self:
        """Refuse values that exclude each other."""
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
        return self


class Part(NamedTuple):
    """What a run is made with in one place."""

    name: str
    """kind and name"""
    factory: Any
    """the class or function that makes it"""
    options: Any = None
    """an object of its `Options`"""
    members: tuple[str, ...] = ()
    """what its protocol has, and it must have; empty for a shipped one"""

    @property
    def is_shipped(self) -> bool:
        """Whether it is no user's own."""
        return not self.members

    def make(self, *args: Any) -> Any:
        """Make it; its options are the last argument, if it has any. Raises PartError for one that cannot be made."""
        options = () if options_class(self.factory) is None else (self.options,)
        try:
            made = self.factory(*args, *options)
            missing = [name for name in self.members if not hasattr(made, name)]
        except Exception as error:
            if not self.members or isinstance(error, InputError):
                raise
            found = f"cannot be made, it raised {type(error).__name__} ({reason_of(error)})"
            raise PartError(self.name, found) from error
        if missing:
            raise PartError(self.name, f"has no {', '.join(missing)}")
        return made


def check_returned(part: str, method: str, found: Any, kind: type, **shapes: tuple[int | None, ...]) -> None:
    """Raise PartError unless what a method of a part has returned is of a kind, and finite.

    `shapes` are of its arrays, by the attribute's name, and `itself` of what is one; None is any length.
    """
    import numpy as np

    if not isinstance(found, kind):
        raise PartError(part, f"{method}: found a {type(found).__name__}, allowed: a {kind.__name__}")
    for name, shape in shapes.items():
        array = np.asarray(found if name == "itself" else getattr(found, name))
        where = method if name == "itself" else f"{method}: {name}"
        if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
            raise PartError(part, f"{where} has shape {array.shape}, allowed {shape}")
        if not np.isfinite(array).all():
            raise PartError(part, f"{where} is not finite")


@contextlib.contextmanager
def naming_parts(config: Config, when: str, check: Callable[[], None]) -> Iterator[None]:
    """Raise PartError in place of an exception that began in the code of a part of a user's own.

    Any other may follow from what one has returned, which `check` looks at.
    """
    try:
        yield
    except PartError as error:
        raise PartError(error.part, error.found, error.when or when) from error
    except InputError:
        raise
    except Exception as error:
        own = [parts for parts in KINDS if getattr(config, parts.kind) not in parts.shipped]
        files = {file: parts.kind for parts in own for file in code_files(parts.load(getattr(config, parts.kind)))}
        for frame in reversed(traceback.extract_tb(error.__traceback__)):
            if (kind := files.get(frame.filename)) is not None:
                found = f"{frame.name} raised {type(error).__name__} in line {frame.lineno} ({reason_of(error)})"
                raise PartError(f"{kind} {getattr(config, kind)}", found, when) from error
        if own:
            with naming_parts(Config(), when, check):
                check()
        raise


def code_files(part: Any) -> set[str]:
    """Files, or cells of a notebook, that hold the code of a class or function."""
    part = inspect.unwrap(part)
    members = [inspect.unwrap(one) for one in vars(part).values() if callable(one)] if inspect.isclass(part) else [part]
    return {one.__code__.co_filename for one in members if hasattr(one, "__code__")}


def part_of(config: Config, parts: Parts) -> Part:
    """The configured part of a kind; InputError for one that cannot be imported, and for options that it has not."""
    name, given = getattr(config, parts.kind), getattr(config, f"{parts.kind}_options")
    label, factory, section = f"{parts.kind} {name}", parts.load(name), parts.sections.get(name)
    if section is None:
        options = part_options(parts.kind, factory, given)
        return Part(label, factory, options, () if name in parts.shipped else parts.members())
    if given:
        raise InputError(f"{parts.kind}_options", f"found {', '.join(given)} for {name}", f"the section {section}")
    return Part(label, factory, getattr(config, section))


def with_checked_parts(config: Config) -> Config:
    """The configuration with the options of parts as these take them: texts of a command line become numbers.

    Raises InputError for a part that cannot be imported, and for options that it does not have.
    """
    for parts in KINDS:
        if (given := getattr(config, f"{parts.kind}_options")) or getattr(config, parts.kind) not in parts.shipped:
            options = part_of(config, parts).options
            config = config.replaced(**{f"{parts.kind}_options": {name: getattr(options, name) for name in given}})
    return config


def applied(base: Config, given: Mapping[str, Any], say: Callable[[str], object]) -> Config:
    """`base` with the `given` fields; `say` gets a line for each part that follows from them and is not among them."""
    found = merge(base, given)
    for name in ("estimator", "front_end"):
        old, new = getattr(base, name), getattr(found, name)
        if name not in given and new != old:
            say(f"{name} is {new} in place of {old}, which does not go with what is given")
    return found


def make_part(parts: Parts, part: Any, *args: Any, options: Any = None) -> Any:
    """A part of a kind, by its name or its class, made with arguments; `options` are by default its own.

    Raises InputError that lists the known names for any other.
    """
    factory = parts.load(part) if isinstance(part, str) else part
    cls = options_class(factory)
    return Part(parts.kind, factory, options or (cls and cls())).make(*args)


def part_options(kind: str, factory: Any, given: Mapping[str, Any]) -> Any:
    """The options of a part with the values that are given, validated by the annotations of its dataclass."""
    cls, where = options_class(factory), f"{kind}_options"
    names = list(inspect.signature(cls).parameters) if cls is not None else []
    for name in given:
        if name not in names:
            raise InputError(f"{where}.{name}", "no such option", ", ".join(names) or "none", nearest(name, names))
    try:
        return None if cls is None else TypeAdapter(cls).validate_python(given)
    except ValidationError as error:
        found = input_error(error)
        raise found.at(f"{where}.{found.where}") from None


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
