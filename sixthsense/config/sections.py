"""The configuration tree, structured like the pipeline; the docstring of a field is its text in the help."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from sixthsense.config import parts
from sixthsense.config.errors import InputError
from sixthsense.config.section import Count, Distribution, Noise, NonNegative, Positive, PositiveCount, Section


class MotionNoise(Section):
    """Noise of the drive: multiplicative on each control tick, plus slip that grows with distance and turn."""

    distribution: Distribution = "gaussian"
    """Distribution of the multiplicative part."""
    speed: Noise = 0.1
    """Noise of the speed, as a fraction of it: sigma, or the half-width if uniform."""
    turn_rate: Noise = 0.1
    """Noise of the turn rate, as a fraction of it: sigma, or the half-width if uniform."""
    slip_position_per_sqrt_m: Noise = 5e-3
    """Sigma of position slip, m / sqrt(m)."""
    slip_position_per_sqrt_rad: Noise = 2e-3
    """Sigma of position slip, m / sqrt(rad)."""
    slip_heading_per_sqrt_m: Noise = math.radians(0.5)
    """Sigma of heading slip, rad / sqrt(m)."""
    slip_heading_per_sqrt_rad: Noise = math.radians(0.5)
    """Sigma of heading slip, rad / sqrt(rad)."""


class LaserNoise(Section):
    """Additive noise of the laser."""

    distribution: Distribution = "gaussian"
    """Distribution of both parts."""
    range_m: Noise = 0.01
    """Noise of a range: sigma, or the half-width if uniform."""
    bearing_rad: Noise = 0.0
    """Noise of a beam's direction: sigma, or the half-width if uniform."""


class WorldConfig(Section):
    """Errors of the simulated robot, and people in the building; the estimators never see either."""

    motion: MotionNoise = MotionNoise()
    laser: LaserNoise = LaserNoise()
    wheel_scale_error: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """True distance and turn are (1 + this) times those the wheels report."""
    drift_rad_per_m: Annotated[float, Field(ge=-10.0, le=10.0)] = 0.0
    """Turn that an unequal pair of wheels adds per metre driven."""
    walkers: Annotated[int, Field(ge=0, le=1000)] = 0
    """People who walk about, besides those of the scene."""
    walkers_blind: bool = False
    """Whether people do not stop for the robot."""


class WheelsConfig(Section):
    """Errors of wheels that stay to one side, beside their noise: sigmas grow with the way, not with its root.

    Scan matching adds them to the motion since the last keyframe, unless a log states its covariance.
    """

    position_m: Noise = 0.01
    """Sigma of position, whatever the way."""
    position_per_m: Noise = 0.05
    """Sigma of position per metre."""
    heading_rad: Noise = 0.005
    """Sigma of heading, whatever the way."""
    heading_per_rad: Noise = 0.05
    """Sigma of heading per radian turned."""
    heading_per_m: Noise = 0.02
    """Sigma of heading per metre, rad."""


class AssumedConfig(Section):
    """Noise that the estimators assume; by default that of the simulator, a mismatch is an experiment."""

    motion: MotionNoise = MotionNoise()
    laser: LaserNoise = LaserNoise()
    wheel_scale_error: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """True distance and turn are (1 + this) times those the wheels report; corrected before use."""
    drift_rad_per_m: Annotated[float, Field(ge=-10.0, le=10.0)] = 0.0
    """Turn that an unequal pair of wheels adds per metre driven; corrected before use."""
    landmark_floor_m: Noise = 0.0
    """Sigma added to every observation, for the deviation of real walls from straight lines."""
    wall_floor_rad: Noise = 0.0
    """Sigma added to the direction of every observed wall."""
    floor_m: Noise = 1e-4
    """Sigma of position added over the motion between two keyframes, so that the covariance has full rank."""
    floor_rad: Noise = 1e-4
    """Sigma of heading added over the motion between two keyframes."""
    wheels: WheelsConfig = WheelsConfig()


DEFAULT_ROBOT_RADIUS_M = 0.2
"""Where neither the configuration nor a scene states a radius."""


class RobotConfig(Section):
    """The differential drive."""

    speed: Positive = 0.5
    """Top speed, m/s."""
    turn_rate: Positive = 1.0
    """Top turn rate, rad/s."""
    deceleration: Positive = 1.0
    """Deceleration of braking, m/s^2, as the guard assumes it; the simulated robot stops at once."""
    radius: NonNegative = 0.0
    """Radius of the robot's disc, m; 0: the scene's."""
    control_period_s: Annotated[float, Field(ge=1e-4, le=10.0)] = 0.02
    """Time between two control ticks."""


class LaserConfig(Section):
    """The scanner, its mount and its rate."""

    beams: Annotated[int, Field(ge=2, le=100_000)] = 360
    """Beams per scan; a full circle is closed, the first beam follows the last."""
    fov: Annotated[float, Field(gt=0.0, le=2 * math.pi)] = 2 * math.pi
    """Field of view, rad, centred on the mount's x axis."""
    max_range: Annotated[float, Field(gt=0.0, le=1000.0)] = 10.0
    """m; a beam that hits nothing nearer returns inf."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of the laser in the robot's frame: x y theta, m and rad."""
    mirrored: bool = False
    """Whether the laser of a log or a robot exchanges left and right: it turns clockwise or is upside down, and neither
    its scans nor its mount say so."""
    period_ticks: PositiveCount = 5
    """Control ticks per scan."""
    sweep_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Duration of one scan, at most the time between two; it ends at the scan's stamp. 0: an instant."""


class KeyframeConfig(Section):
    """When a scan is a keyframe, and is used: after the robot has moved this far since the last one."""

    distance_m: NonNegative = 0.25
    """Distance since the last keyframe after which a scan is one. With this or the turn at 0 every scan after any
    motion is a keyframe."""
    turn_rad: NonNegative = 0.15
    """Turn since the last keyframe after which a scan is one."""


class PartitionConfig(Section):
    """First level: split the scan where neighbouring ranges jump (report eq. 4)."""

    method: Literal["adaptive", "fixed"] = "adaptive"
    """adaptive: the jump allowed grows with range and beam spacing (Borges and Aldon 2004)."""
    epsilon_m: Positive = 1.0
    """Jump allowed by the fixed method."""
    incidence_rad: Annotated[float, Field(gt=0.0, le=1.5)] = math.radians(10.0)
    """Adaptive: the flattest angle between beam and wall that still counts as one wall."""


class SplitConfig(Section):
    """Second level: iterative end point fitting (report algorithm 1)."""

    epsilon_m: Positive = 0.06
    """A piece is split at its farthest point when that lies farther than this from the chord."""


class LinesConfig(Section):
    """Line fitting by least squares, without returns that are far from the line."""

    threshold_m: Positive = 0.05
    """Greatest distance of a return from its line."""
    min_points: Annotated[int, Field(ge=3)] = 6
    """A line needs this many inliers."""
    min_length_m: NonNegative = 0.2
    """Shorter lines are dropped."""
    cut_false_alarm: Annotated[float, Field(ge=0.0, le=1.0)] = 0.01
    """A line is cut where two lines explain its returns better than a straight wall allows with this probability; 0:
    never."""


class PointsConfig(Section):
    """Which end points and intersections count as landmarks."""

    max_gap_m: Positive = 0.3
    """Two walls meet in a corner only if both end within this distance of it."""
    min_points: Annotated[int, Field(ge=3)] = 8
    """Rule 4: fewest points of a partition with a free end."""
    max_sigma_m: Positive = 0.15
    """Largest sigma of a landmark along any direction; others are not reported."""


class FeaturesConfig(Section):
    """From a scan to walls and landmarks (report section 4.2)."""

    landmarks: Literal["corners", "walls", "both"] = "walls"
    """corners: corners and free ends, as in the report; walls: walls alone; both: walls and free ends (a corner, where
    two walls meet, adds no information to them)."""
    deskew: bool = True
    """Transform the returns of a scan that took time to the robot's pose at its end, by odometry."""

    partition: PartitionConfig = PartitionConfig()
    split: SplitConfig = SplitConfig()
    lines: LinesConfig = LinesConfig()
    points: PointsConfig = PointsConfig()


class AssociationConfig(Section):
    """Which observation is of which landmark (report section 4.3)."""

    match_gate: Positive = 13.8155
    """Squared Mahalanobis distance of a match, at most, given the other matches: 0.999 of chi-square with 2 degrees of
    freedom. An observation without a match counts as one at the gate."""
    new_gate: Positive = 27.631
    """Squared Mahalanobis distance of a new landmark from every known one, at least: 0.999999 of chi-square."""
    new_separation_m: NonNegative = 0.3
    """A new landmark is at least this far from every known one, unless most of the scan matches. A wall may also differ
    in direction, or lie apart along its line."""
    known_probability: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """A named observation outside this quantile of its innovation's distribution is a misread name; 1: never."""
    proposed_by: Literal["estimate", "scan-matching"] = "estimate"
    """Where the robot is when matches are chosen: by the estimator's prediction; or by scan matching, which is used
    for nothing else."""
    cull_below: Count = 3
    """A landmark with fewer observations than this 25 keyframes after its first one is removed; 0: none is."""


class ScansConfig(Section):
    """Alignment of scans with earlier scans, and loop closures (front_end scan-matching)."""

    max_range_m: Positive = 30.0
    """Returns farther away are not used."""
    loop_closures: bool = True
    """Off: scans are linked to recent ones alone, and no loop is closed."""
    min_score: Annotated[float, Field(ge=0.3, le=1.0)] = 0.62
    """Least share of a submap's points that a loop closure must explain; lower finds more loop closures, and more wrong
    ones."""
    final_pass: bool = True
    """At the end align the scans between keyframes once more."""


class ISAM2Config(Section):
    """The smoother (Kaess et al., IJRR 31(2), 2012)."""

    relinearize_threshold: Positive = 0.02
    """A variable that has moved farther than this, m or rad, is relinearized."""
    iterations: PositiveCount = 2
    """Gauss-Newton steps per update, at most; with one the smoother is overconfident where headings are uncertain."""
    undo_probability: Annotated[float, Field(gt=0.0, le=1.0)] = 0.999999
    """A match is rejected later if its residual lies outside this quantile of its noise; 1: never."""


class GridConfig(Section):
    """Hit grid and sense grid (report sections 4.4 and 4.5)."""

    cell_m: Annotated[float, Field(ge=1e-3, le=10.0)] = 0.05
    """Side of a cell."""
    walls: bool = True
    """Fitted walls, and gaps between returns of one wall that the robot could not pass, count as hits, too."""
    min_hits: PositiveCount = 1
    """Fewest hits of an obstacle."""
    passes_per_hit: Positive = 4.0
    """A cell is free again after more passes per hit than this."""
    max_hits: PositiveCount = 10
    """Further hits are not counted, so that a wall that was removed can be erased."""
    no_return_passes: bool = True
    """A beam without a return passes all cells up to the maximum range; off where glass gives none."""
    clearance_m: Annotated[float, Field(ge=0.0, le=10.0)] = 0.05
    """Kept from obstacles, beyond the robot's radius, where there is room; always by a robot without a guard."""

    @model_validator(mode="after")
    def _hits(self) -> Self:
        if self.min_hits > self.max_hits:
            raise InputError("min_hits", f"found {self.min_hits}", f"at most max_hits, {self.max_hits}")
        return self


class ExploreConfig(Section):
    """Where to look next, and when all is seen (report section 4.5)."""

    return_home: bool = True
    """Drive back to the start when all is seen."""
    margin_m: NonNegative = 1.0
    """How far outside the region unseen cells count, where they continue unseen cells of the region; up to the laser's
    range when nothing else is left to see."""
    loop_closure: bool = True
    """Drive back to a place where the pose was certain when it no longer is."""


class RRTStarConfig(Section):
    """The sampling planner: RRT* (Karaman and Frazzoli 2011) and Informed RRT* (Gammell et al. 2014)."""

    informed: bool = True
    """Once there is a path, sample the ellipse that a shorter one must lie in (Informed RRT*)."""
    iterations: Annotated[int, Field(ge=1, le=10_000_000)] = 5_000
    """States drawn per plan; without a path by then the planner gives up."""


GOAL_SLACK_M = 0.05
"""a goal this near is reached: one cell of the map"""


class FollowConfig(Section):
    """Orient, then translate (report section 4.4)."""

    heading_slack_rad: Positive = 0.02
    """The robot drives when its heading is this close to the waypoint's direction."""
    distance_slack_m: Annotated[float, Field(gt=0.0, le=GOAL_SLACK_M)] = 0.02
    """A waypoint this near is reached."""


class SafetyConfig(Section):
    """Paths keep a margin where there is room; the guard slows and stops the robot by the scans of the last second."""

    max_margin_m: Annotated[float, Field(ge=0.0, le=10.0)] = 0.3
    """Largest margin beyond grid.clearance-m that paths are to keep, however uncertain the pose; 0: no margin."""
    guard: bool = True
    """Off: commands are not checked."""


def _table(value: Any) -> Any:
    """The options of a part as a table; they may be given as an object of its `Options`."""
    options = dataclasses.asdict(value) if dataclasses.is_dataclass(value) and not isinstance(value, type) else value
    return {str(k).replace("-", "_"): one for k, one in options.items()} if isinstance(options, Mapping) else options


PartOptions = Annotated[dict[str, Any], BeforeValidator(_table)]


class Config(Section):
    """All settings of a run: the same configuration and source give the same run, bit for bit."""

    scene: str = "apartment"
    """Shipped scene, or a file: .toml or map_server .yaml."""
    preset: str = "default"
    """Set of values: default, worn, noiseless, report, log, mrclam or victoria. A file and options override it."""
    estimator: Annotated[str, parts.ESTIMATORS] = "ekf-invariant"
    """Back end: ekf-invariant, ekf, isam2, or your own. ekf-invariant is a filter that stays consistent when the robot
    turns, ekf is the report's filter, isam2 a smoother; `sixthsense parts` says how one of yours is named."""
    front_end: Annotated[str, parts.FRONT_ENDS] = "landmarks"
    """What the estimator is given: landmarks, scan-matching, or your own. landmarks: observations of walls and points;
    scan-matching: relative poses of keyframes, for an estimator that keeps all poses, isam2. Logs with scans: isam2
    and scan-matching, unless an estimator is named."""
    extractor: Annotated[str, parts.EXTRACTORS] = "lines"
    """What finds landmarks in a scan: lines, or your own. lines: walls, corners and free ends; `features` has its
    options."""
    place_search: Annotated[str, parts.PLACE_SEARCHES] = "branch-and-bound"
    """What proposes old places that the robot may be at again: branch-and-bound, or your own. With front_end
    scan-matching; what is proposed is judged and verified in any case."""
    calibrate_wheels: bool = False
    """Estimate the wheels' systematic errors with the pose. For filters, with landmarks; `core/wheels.py` has the
    prior."""
    calibrate_sensor: bool = False
    """Estimate the lens of a camera with the pose. For filters, with logs of observations that name their landmark;
    `core/sensor.py` has the prior."""
    no_odometry: bool = False
    """Use scans alone: the last velocity predicts. A scan's motion is found by scan matching; wheels that are there are
    ignored."""
    time_offset: float | None = None
    """Time by which the stamps of a log's odometry are early beside those of its scans, s. None: it is looked for, by
    the turns that both see."""
    planner: Annotated[str, parts.PLANNERS] = "astar"
    """Path planner: astar, rrtstar, or your own. astar: shortest over the grid's cells; rrtstar: sampled in the
    plane."""
    explorer: Annotated[str, parts.EXPLORERS] = "frontier"
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
        for known in parts.KINDS:
            options, part = f"{known.kind}_options", getattr(self, known.kind)
            if known.name_of(table.get(known.kind, part)) != part:
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
        if front_end == "scan-matching" and estimator is None and self.estimator in parts.FILTERS:
            return {**table, "estimator": "isam2"}
        return table

    @model_validator(mode="after")
    def _together(self) -> Self:
        """Refuse values that exclude each other."""
        if self.goal is not None and self.tour is not None:
            raise InputError("goal", "found beside a tour", "one of the two")
        if self.front_end == "scan-matching" and self.estimator in parts.FILTERS:
            raise InputError("front_end", f"found scan-matching with estimator {self.estimator}", parts.KEEP_POSES)
        if self.no_odometry and (self.front_end != "scan-matching" or self.calibrate_wheels):
            found = "calibrate_wheels" if self.calibrate_wheels else f"front_end {self.front_end}"
            raise InputError("no_odometry", f"found true with {found}", "with front_end scan-matching alone")
        between = self.laser.period_ticks * self.robot.control_period_s
        if self.laser.sweep_s > between * (1.0 + 1e-9):
            raise InputError(
                "laser.sweep_s", f"found {self.laser.sweep_s:g}", f"at most {between:g}, the time between two scans"
            )
        return self
