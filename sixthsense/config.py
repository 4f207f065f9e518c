"""The configuration tree, which is the pipeline's tree: presets, loading, saving, and the one validator.

Every dataclass below checks itself when it is made, so a Config that exists is a Config that can run, whether
it came from a default, a preset, a file or a flag.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from sixthsense import __version__

C = TypeVar("C", bound="Section")


class ConfigError(ValueError):
    """One line that names the field, what was found and what is allowed."""


@dataclass(frozen=True)
class Range:
    """The interval a number must lie in; an open lower end excludes `low` itself."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False

    def __contains__(self, value: float) -> bool:
        above = value > self.low if self.open_low else value >= self.low
        return above and value <= self.high

    def __str__(self) -> str:
        if self.high < math.inf:
            return f"{'above ' if self.open_low else ''}{self.low:g} to {self.high:g}"
        return f"above {self.low:g}" if self.open_low else f"at least {self.low:g}"


Positive = Annotated[float, Range(0.0, open_low=True)]
NonNegative = Annotated[float, Range(0.0)]
Fraction = Annotated[float, Range(0.0, 1.0)]
Probability = Annotated[float, Range(0.0, 1.0 - 1e-12, open_low=True)]
PositiveCount = Annotated[int, Range(1)]
Count = Annotated[int, Range(0)]
Distribution = Literal["gaussian", "uniform"]


class Section:
    """A node of the tree: on creation each field is checked against its annotation and coerced to it."""

    def __post_init__(self) -> None:
        for name, hint in _hints(type(self)).items():
            object.__setattr__(self, name, _checked(name, hint, getattr(self, name)))


def _hints(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls, include_extras=True)


def _checked(name: str, hint: Any, value: Any) -> Any:
    """`value` coerced to `hint`; ConfigError naming the field otherwise."""
    origin = typing.get_origin(hint)
    if origin is Annotated:
        base, bounds = typing.get_args(hint)
        value = _checked(name, base, value)
        if value not in bounds:
            raise ConfigError(f"{name}: found {value!r}, allowed: {bounds}")
        return value
    if origin is Literal:
        choices = typing.get_args(hint)
        if value not in choices:
            raise ConfigError(f"{name}: found {value!r}, allowed: {', '.join(map(str, choices))}")
        return value
    if origin in (typing.Union, types.UnionType):
        inner = next(a for a in typing.get_args(hint) if a is not type(None))
        return None if value is None else _checked(name, inner, value)
    if origin is tuple:
        args = typing.get_args(hint)
        if not isinstance(value, (tuple, list)) or len(value) != len(args):
            raise ConfigError(f"{name}: found {value!r}, allowed: {len(args)} numbers")
        return tuple(_checked(name, a, v) for a, v in zip(args, value, strict=True))
    if hint is float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ConfigError(f"{name}: found {value!r}, allowed: a finite number")
        return float(value)
    if hint is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ConfigError(f"{name}: found {value!r}, allowed: a whole number")
        return value
    if not isinstance(value, hint):
        kind = {bool: "true or false", str: "a text"}.get(hint, f"a table of {hint.__name__}")
        raise ConfigError(f"{name}: found {value!r}, allowed: {kind}")
    return value


@dataclass(frozen=True)
class MotionNoise(Section):
    """Noise of the drive: multiplicative on each control tick, plus slip that grows with the way made."""

    distribution: Distribution = "gaussian"
    """Of the multiplicative part."""
    speed: NonNegative = 0.1
    """Of v, as a fraction of it: sigma, or the half-width if uniform."""
    turn_rate: NonNegative = 0.1
    """Of omega, as a fraction of it: sigma, or the half-width if uniform."""
    slip_position_per_sqrt_m: NonNegative = 5e-3
    """Sigma of position slip, m / sqrt(m)."""
    slip_position_per_sqrt_rad: NonNegative = 2e-3
    """Sigma of position slip, m / sqrt(rad)."""
    slip_heading_per_sqrt_m: NonNegative = math.radians(0.5)
    """Sigma of heading slip, rad / sqrt(m)."""
    slip_heading_per_sqrt_rad: NonNegative = math.radians(0.5)
    """Sigma of heading slip, rad / sqrt(rad)."""


@dataclass(frozen=True)
class LaserNoise(Section):
    """Additive noise of the laser."""

    distribution: Distribution = "gaussian"
    """Of both parts."""
    range_m: NonNegative = 0.01
    """Of a range: sigma, or the half-width if uniform."""
    bearing_rad: NonNegative = 0.0
    """Of a beam's direction: sigma, or the half-width if uniform."""


@dataclass(frozen=True)
class WorldConfig(Section):
    """What the simulator does; the estimators never see it."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    laser: LaserNoise = field(default_factory=LaserNoise)
    wheel_scale_error: Annotated[float, Range(-0.5, 0.5)] = 0.0
    """The true way is (1 + this) times what the wheels report."""
    drift_rad_per_m: float = 0.0
    """Turn that an unequal pair of wheels adds per metre driven."""


@dataclass(frozen=True)
class AssumedConfig(Section):
    """What the estimators believe of the noise; equal to the simulator's by default, a mismatch is an experiment."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    laser: LaserNoise = field(default_factory=LaserNoise)
    landmark_floor_m: NonNegative = 0.0
    """Sigma added to every sighting: how far real walls are from the straight lines fitted to them."""
    floor_m: NonNegative = 1e-4
    """Sigma of position every key scan's worth of motion adds at least, so that the covariance has full rank."""
    floor_rad: NonNegative = 1e-4
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
    integration_step_s: Positive = 0.01
    """Longest RK4 step within a tick."""


@dataclass(frozen=True)
class LaserConfig(Section):
    """The scanner, its mount and its rate."""

    beams: Annotated[int, Range(2, 100_000)] = 360
    """Beams per scan; a full circle is closed, the first beam follows the last."""
    fov: Annotated[float, Range(0.0, 2 * math.pi, open_low=True)] = 2 * math.pi
    """Field of view, rad, centred on the mount's x axis."""
    max_range: Positive = 10.0
    """A beam that meets nothing nearer returns inf, m."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of the laser in the robot's frame: x y theta."""
    period_ticks: PositiveCount = 5
    """Control ticks per scan."""


@dataclass(frozen=True)
class KeyScanConfig(Section):
    """A scan is a key scan, and used, when the robot has moved this far since the last one."""

    distance_m: NonNegative = 0.25
    """0 takes every scan after any motion."""
    turn_rad: NonNegative = 0.15
    """0 takes every scan after any turn."""


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
    min_angle_rad: Positive = math.radians(25.0)
    """Two walls at a flatter angle make no corner."""
    range_margin_m: NonNegative = 0.2
    """Rule 2: an end this close to the maximum range is none."""
    min_points: Annotated[int, Range(3)] = 8
    """Rule 4: the wall of a loose end needs this many points."""
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
    """A new landmark is at least this far from every known one of its kind."""
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
    clearance_m: NonNegative = 0.05
    """Added to the robot's radius when obstacles are inflated."""


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


@dataclass(frozen=True)
class Config(Section):
    """Everything that determines a run: one of these and a source give the same run, bit for bit."""

    scene: str = "apartment"
    """A shipped scene's name or a file (.toml, map_server .yaml, .scn)."""
    preset: str = "default"
    """The preset these values started from; changing it here changes nothing else."""
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
    max_time: Positive = 600.0
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


_REPORT_MOTION = {
    "distribution": "uniform", "speed": 0.1, "turn_rate": 0.1, "slip_position_per_sqrt_m": 0.0,
    "slip_position_per_sqrt_rad": 0.0, "slip_heading_per_sqrt_m": 0.0, "slip_heading_per_sqrt_rad": 0.0,
}  # fmt: skip
_REPORT_LASER = {"distribution": "uniform", "range_m": 0.01, "bearing_rad": 0.05 * 2 * math.pi / 180}
_SILENT_MOTION = {**_REPORT_MOTION, "distribution": "gaussian", "speed": 0.0, "turn_rate": 0.0}

PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    # What white noise hides: a wheel-radius scale error and an unequal pair, unknown to the estimators.
    "worn": {"world": {"wheel_scale_error": 0.02, "drift_rad_per_m": math.radians(0.5)}},
    "noiseless": {"world": {"motion": _SILENT_MOTION, "laser": {"range_m": 0.0, "bearing_rad": 0.0}}},
    # 181 beams over [-pi, pi] whose last repeats the first: 180 around a closed circle.
    "report": {
        "robot": {"speed": 0.1, "turn_rate": 0.5, "control_period_s": 1 / 60, "integration_step_s": 0.01},
        "laser": {"beams": 180, "max_range": 5.0, "period_ticks": 10},
        "world": {"motion": _REPORT_MOTION, "laser": _REPORT_LASER},
        "assumed": {"motion": _REPORT_MOTION, "laser": _REPORT_LASER},
        "keyscans": {"distance_m": 0.0, "turn_rad": 0.0},
        "features": {
            "partition": {"method": "fixed", "epsilon_m": 1.0},
            "lines": {"ransac_threshold_m": 0.04, "ransac_iterations": 1000, "min_points": 8},
        },
        "association": {"method": "report", "candidate_sightings": 1},
        "grid": {"cell_m": 0.04},
        "follow": {"heading_slack_rad": 0.01, "distance_slack_m": 0.01},
        "max_time": 1800.0,
    },
    "intel": {
        "laser": {"beams": 180, "fov": math.radians(179.0), "max_range": 50.0},
        "max_time": 1e6,
    },
}  # fmt: skip


def preset(name: str = "default") -> Config:
    """The named preset's Config; ConfigError listing the known names for any other."""
    if name not in PRESETS:
        raise ConfigError(f"preset: found {name!r}, allowed: {', '.join(PRESETS)}")
    return merge(Config(preset=name), PRESETS[name])


def merge(base: C, table: Mapping[str, Any], path: str = "") -> C:
    """`base` with the fields that `table` (nested, as a TOML file is) names replaced.

    Raises ConfigError with the dotted name of a field that does not exist or whose value is not allowed.
    """
    known = {f.name: f for f in dataclasses.fields(typing.cast(Any, base))}
    changes: dict[str, Any] = {}
    for key, value in table.items():
        name = key.replace("-", "_")
        if name not in known:
            raise ConfigError(f"{path}{key}: no such field, allowed: {', '.join(known)}")
        current = getattr(base, name)
        if isinstance(current, Section):
            if not isinstance(value, Mapping):
                raise ConfigError(f"{path}{key}: found {value!r}, allowed: a table")
            changes[name] = merge(current, value, f"{path}{key}.")
        else:
            try:
                changes[name] = _checked(key, _hints(type(base))[name], value)
            except ConfigError as error:
                raise ConfigError(f"{path}{error}") from None
    return typing.cast(C, dataclasses.replace(typing.cast(Any, base), **changes))


def load_config(file: str | Path, base: Config | None = None) -> Config:
    """Read a TOML file, partial or whole, over `base` (its own `preset` field's values if none is given).

    Raises ConfigError for a file that cannot be read, is not TOML, or holds a field that is not allowed.
    """
    path = Path(file)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not UTF-8 text, allowed: a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not TOML ({error})") from None
    table.pop("versions", None)  # written for the reader of a run folder, not a setting
    try:
        return merge(base or preset(table.get("preset", "default")), table)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def as_table(section: Section) -> dict[str, Any]:
    """The tree as nested plain values, absent (None) fields left out, ready for TOML."""
    table: dict[str, Any] = {}
    for f in dataclasses.fields(typing.cast(Any, section)):
        value = getattr(section, f.name)
        if value is not None:
            table[f.name] = as_table(value) if isinstance(value, Section) else value
    return table


def save_config(config: Config, file: str | Path) -> None:
    """Write the whole tree, and the versions that ran it, as TOML; `load_config` reads the same Config back."""
    import platform
    from importlib.metadata import version

    import tomli_w

    versions = {"sixthsense": __version__, "python": platform.python_version()}
    versions |= {name: version(name) for name in ("numpy", "scipy", "numba")}
    Path(file).write_text(tomli_w.dumps({**as_table(config), "versions": versions}), encoding="utf-8")
