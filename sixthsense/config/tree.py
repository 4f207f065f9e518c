"""The configuration tree, which is the pipeline's tree; a field's text is what `--help` says of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

from sixthsense.config.section import ConfigError, Range, Section

Positive = Annotated[float, Range(0.0, open_low=True)]
NonNegative = Annotated[float, Range(0.0)]
Noise = Annotated[float, Range(0.0, 100.0)]
Fraction = Annotated[float, Range(0.0, 1.0)]
Probability = Annotated[float, Range(0.0, 1.0 - 1e-12, open_low=True)]
PositiveCount = Annotated[int, Range(1)]
Count = Annotated[int, Range(0)]
Distribution = Literal["gaussian", "uniform"]


@dataclass(frozen=True)
class MotionNoise(Section):
    """Noise of the drive: multiplicative on each control tick, plus slip that grows with the way made."""

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
    slip_heading_per_sqrt_m: Noise = math.radians(0.5)
    """Sigma of heading slip, rad / sqrt(m)."""
    slip_heading_per_sqrt_rad: Noise = math.radians(0.5)
    """Sigma of heading slip, rad / sqrt(rad)."""


@dataclass(frozen=True)
class LaserNoise(Section):
    """Additive noise of the laser."""

    distribution: Distribution = "gaussian"
    """Of both parts."""
    range_m: Noise = 0.01
    """Of a range: sigma, or the half-width if uniform."""
    bearing_rad: Noise = 0.0
    """Of a beam's direction: sigma, or the half-width if uniform."""


@dataclass(frozen=True)
class WorldConfig(Section):
    """What the simulator does; the estimators never see it."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    laser: LaserNoise = field(default_factory=LaserNoise)
    wheel_scale_error: Annotated[float, Range(-0.5, 0.5)] = 0.0
    """The true way and turn are (1 + this) times what the wheels report."""
    drift_rad_per_m: Annotated[float, Range(-10.0, 10.0)] = 0.0
    """Turn that an unequal pair of wheels adds per metre driven."""


@dataclass(frozen=True)
class AssumedConfig(Section):
    """What the estimators believe of the noise; equal to the simulator's by default, a mismatch is an experiment."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    laser: LaserNoise = field(default_factory=LaserNoise)
    wheel_scale_error: Annotated[float, Range(-0.5, 0.5)] = 0.0
    """The true way and turn are (1 + this) times what the wheels report: corrected before it is used."""
    drift_rad_per_m: Annotated[float, Range(-10.0, 10.0)] = 0.0
    """Turn that an unequal pair of wheels adds per metre driven: corrected before it is used."""
    landmark_floor_m: Noise = 0.0
    """Sigma added to every sighting: how far real walls are from the straight lines fitted to them."""
    floor_m: Noise = 1e-4
    """Sigma of position every key scan's worth of motion adds at least, so that the covariance has full rank."""
    floor_rad: Noise = 1e-4
    """The same for the heading."""


@dataclass(frozen=True)
class RobotConfig(Section):
    """The differential drive."""

    speed: Positive = 0.5
    """Top speed, m/s."""
    turn_rate: Positive = 1.0
    """Top turn rate, rad/s."""
    radius: NonNegative = 0.0
    """Of the disc, m; 0 takes the scene's."""
    control_period_s: Annotated[float, Range(1e-4, 10.0)] = 0.02
    """Between two control ticks."""
    integration_step_s: Annotated[float, Range(1e-4)] = 0.01
    """Longest RK4 step within a tick."""


@dataclass(frozen=True)
class LaserConfig(Section):
    """The scanner, its mount and its rate."""

    beams: Annotated[int, Range(2, 100_000)] = 360
    """Beams per scan; a full circle is closed, the first beam follows the last."""
    fov: Annotated[float, Range(0.0, 2 * math.pi, open_low=True)] = 2 * math.pi
    """Field of view, rad, centred on the mount's x axis."""
    max_range: Annotated[float, Range(0.0, 1000.0, open_low=True)] = 10.0
    """A beam that meets nothing nearer returns inf, m."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of the laser in the robot's frame: x y theta."""
    period_ticks: PositiveCount = 5
    """Control ticks per scan."""


@dataclass(frozen=True)
class KeyScanConfig(Section):
    """A scan is a key scan, and used, when the robot has moved this far since the last one."""

    distance_m: NonNegative = 0.25
    """With either at 0 every scan after any motion is one."""
    turn_rad: NonNegative = 0.15
    """See above."""


@dataclass(frozen=True)
class PartitionConfig(Section):
    """First level: split the scan where neighbouring ranges jump (report eq. 4)."""

    method: Literal["adaptive", "fixed"] = "adaptive"
    """adaptive: the jump allowed grows with range and beam spacing (Borges and Aldon 2004)."""
    epsilon_m: Positive = 1.0
    """Jump allowed by the fixed method."""
    incidence_rad: Annotated[float, Range(0.0, 1.5, open_low=True)] = math.radians(10.0)
    """Adaptive: the flattest angle between beam and wall that still counts as one wall."""


@dataclass(frozen=True)
class SplitConfig(Section):
    """Second level: iterative end point fitting (report algorithm 1)."""

    enabled: bool = True
    """Off: RANSAC works on the first-level partitions."""
    epsilon_m: Positive = 0.06
    """A piece is split at its farthest point when that lies farther than this from the chord."""


@dataclass(frozen=True)
class LinesConfig(Section):
    """Line fitting: RANSAC, then orthogonal least squares."""

    ransac: bool = True
    """Off: the whole second-level piece is fitted as one line."""
    ransac_threshold_m: Positive = 0.05
    """Greatest distance of an inlier from its line."""
    ransac_iterations: PositiveCount = 20
    """Pairs drawn per piece at most; stops early when all points are inliers."""
    least_squares: bool = True
    """Off: the line through RANSAC's best pair."""
    min_points: Annotated[int, Range(3)] = 6
    """A line needs this many inliers."""
    min_length_m: NonNegative = 0.2
    """A wall shorter than this is no wall."""


@dataclass(frozen=True)
class LandmarksConfig(Section):
    """Which end points and intersections count as landmarks."""

    corners: bool = True
    """Intersections of neighbouring walls."""
    ends: bool = True
    """Loose ends of walls, under the report's four rules."""
    max_gap_m: Positive = 0.3
    """Two walls meet in a corner only if both end within this of it."""
    min_angle_rad: Annotated[float, Range(0.0, math.pi / 2, open_low=True)] = math.radians(25.0)
    """Two walls at a flatter angle make no corner."""
    range_margin_m: NonNegative = 0.2
    """Rule 2: an end this close to the maximum range is none."""
    min_points: Annotated[int, Range(3)] = 8
    """Rule 4: the partition that ends in a loose end needs this many points."""
    max_sigma_m: Positive = 0.15
    """A landmark known worse than this along any direction is not reported."""


@dataclass(frozen=True)
class FeaturesConfig(Section):
    """From a scan to walls and landmarks (report section 4.2)."""

    partition: PartitionConfig = field(default_factory=PartitionConfig)
    split: SplitConfig = field(default_factory=SplitConfig)
    lines: LinesConfig = field(default_factory=LinesConfig)
    landmarks: LandmarksConfig = field(default_factory=LandmarksConfig)


@dataclass(frozen=True)
class AssociationConfig(Section):
    """Which sighting is of which landmark (report section 4.3)."""

    method: Literal["chi2", "report"] = "chi2"
    """chi2: gates by probability; report: squared Mahalanobis thresholds."""
    match_probability: Probability = 0.999
    """chi2: a match lies inside this much of the innovation's distribution."""
    new_probability: Probability = 0.999999
    """chi2: a new landmark lies outside this much of every known one's."""
    match_below: Positive = 20.0
    """report: squared Mahalanobis distance of a match."""
    new_above: Positive = 200.0
    """report: squared Mahalanobis distance, to every landmark, of a new one."""
    pre_gate_m: Positive = 1.5
    """Only landmarks this near a sighting are looked at."""
    new_separation_m: NonNegative = 0.3
    """A new landmark is at least this far from every known one."""
    candidate_sightings: PositiveCount = 1
    """A landmark joins the state at its n-th sighting; 1: at once."""
    candidate_gate_m: Positive = 0.2
    """A sighting this near a candidate is of that candidate."""
    candidate_scans: PositiveCount = 30
    """A candidate unseen for this many key scans is dropped."""
    culling: bool = True
    """Remove landmarks that were seen too rarely."""
    cull_period: PositiveCount = 25
    """Key scans between two checks."""
    cull_below: Count = 3
    """A landmark with fewer sightings than this, a period after its birth, is removed."""


@dataclass(frozen=True)
class GridConfig(Section):
    """Hit grid and sense grid (report sections 4.4 and 4.5)."""

    cell_m: Annotated[float, Range(1e-3, 10.0)] = 0.05
    """Side of a cell."""
    walls: bool = True
    """Fitted walls count as hits, beside the laser's ends."""
    min_hits: PositiveCount = 1
    """Fewest hits of an obstacle."""
    passes_per_hit: Positive = 4.0
    """A cell is free again when it was passed more than this often per hit."""
    max_hits: PositiveCount = 10
    """Hits beyond this count no more, so that a wall that is seen to have gone can go."""
    no_return_passes: bool = True
    """A beam that met nothing crossed all cells up to the maximum range; off where glass and black swallow beams."""
    clearance_m: Annotated[float, Range(0.0, 10.0)] = 0.05
    """Added to the robot's radius when obstacles are inflated."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_hits > self.max_hits:
            raise ConfigError(f"min_hits: found {self.min_hits}, allowed: at most max_hits, {self.max_hits}")


@dataclass(frozen=True)
class FollowConfig(Section):
    """Orient, then translate (report section 4.4)."""

    heading_slack_rad: Positive = 0.02
    """The robot drives when its heading is this close to the way point's direction."""
    distance_slack_m: Positive = 0.02
    """A way point this near is reached."""
    goal_slack_m: Positive = 0.05
    """A goal this near is reached."""
    shortcut: bool = True
    """Aim for the furthest way point in line of sight, not for the next."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.distance_slack_m > self.goal_slack_m:
            found = f"distance_slack_m: found {self.distance_slack_m:g}"
            raise ConfigError(f"{found}, allowed: at most goal_slack_m, {self.goal_slack_m:g}")


@dataclass(frozen=True)
class Config(Section):
    """Everything that determines a run: one of these and a source give the same run, bit for bit."""

    scene: str = "apartment"
    """A shipped scene's name or a file (.toml, map_server .yaml, .scn)."""
    preset: str = "default"
    """Values to start from, under those of a file and of options: default, worn, noiseless, report or intel."""
    estimator: Literal["ekf"] = "ekf"
    """Back end."""
    planner: Literal["astar"] = "astar"
    """Path planner."""
    task: Literal["goal", "tour"] = "goal"
    """goal: drive there; tour: repeat the scene's list of goals until max-time."""
    goal: tuple[float, float] | None = None
    """x y, world frame, m; none: the scene's."""
    start: tuple[float, float, float] | None = None
    """x y theta, world frame; none: the scene's."""
    region: tuple[float, float, float, float] | None = None
    """x0 y0 x1 y1 of the region of interest; none: the scene's."""
    seed: Count = 0
    """Of all randomness."""
    max_time: Annotated[float, Range(0.0, 1e9, open_low=True)] = 600.0
    """Simulated seconds after which the run ends."""
    robot: RobotConfig = field(default_factory=RobotConfig)
    laser: LaserConfig = field(default_factory=LaserConfig)
    world: WorldConfig = field(default_factory=WorldConfig)
    assumed: AssumedConfig = field(default_factory=AssumedConfig)
    keyscans: KeyScanConfig = field(default_factory=KeyScanConfig)
    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    association: AssociationConfig = field(default_factory=AssociationConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    follow: FollowConfig = field(default_factory=FollowConfig)
