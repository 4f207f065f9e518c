"""Configuration of the pipeline from a scan to estimate and map, stage by stage."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

from sixthsense.config.errors import InputError
from sixthsense.config.section import Count, NonNegative, Positive, PositiveCount, Range, Section


@dataclass(frozen=True)
class KeyframeConfig(Section):
    """When a scan is a keyframe, and is used: after the robot has moved this far since the last one."""

    distance_m: NonNegative = 0.25
    """With either value at 0 every scan after any motion is a keyframe."""
    turn_rad: NonNegative = 0.15
    """See above."""


@dataclass(frozen=True)
class PartitionConfig(Section):
    """First level: split the scan where neighbouring ranges jump (report eq. 4)."""

    method: Literal["adaptive", "fixed"] = "adaptive"
    """adaptive: the jump allowed grows with range and beam spacing (Borges and Aldon 2004)."""
    epsilon_m: Positive = 1.0
    """Jump allowed by the fixed method."""
    incidence_rad: Annotated[float, Range(0.0, 1.5, open_low=True, unit="rad")] = math.radians(10.0)
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

    ransac_threshold_m: Positive = 0.05
    """Greatest distance of an inlier from its line."""
    ransac_iterations: PositiveCount = 20
    """Pairs drawn per piece at most; stops early when all points are inliers."""
    least_squares: bool = True
    """Off: the line through RANSAC's best pair."""
    min_points: Annotated[int, Range(3)] = 6
    """A line needs this many inliers."""
    min_length_m: NonNegative = 0.2
    """Shorter lines are dropped."""
    cut_false_alarm: Annotated[float, Range(0.0, 1.0)] = 0.01
    """A line is cut where two lines explain its returns better than a straight wall allows with this probability; 0:
    never."""


@dataclass(frozen=True)
class PointsConfig(Section):
    """Which end points and intersections count as landmarks."""

    max_gap_m: Positive = 0.3
    """Two walls meet in a corner only if both end within this distance of it."""
    min_points: Annotated[int, Range(3)] = 8
    """Rule 4: fewest points of a partition with a free end."""
    max_sigma_m: Positive = 0.15
    """Largest sigma of a landmark along any direction; others are not reported."""


@dataclass(frozen=True)
class FeaturesConfig(Section):
    """From a scan to walls and landmarks (report section 4.2)."""

    landmarks: Literal["corners", "walls", "both"] = "both"
    """corners: corners and free ends, as in the report; walls: walls alone; both: walls and free ends (a corner, where
    two walls meet, adds no information to them)."""
    deskew: bool = True
    """Transform the returns of a scan that took time to the robot's pose at its end, by odometry."""

    partition: PartitionConfig = field(default_factory=PartitionConfig)
    split: SplitConfig = field(default_factory=SplitConfig)
    lines: LinesConfig = field(default_factory=LinesConfig)
    points: PointsConfig = field(default_factory=PointsConfig)


@dataclass(frozen=True)
class AssociationConfig(Section):
    """Which observation is of which landmark (report section 4.3)."""

    match_gate: Positive = 13.8155
    """Squared Mahalanobis distance of a match, at most, given the other matches: 0.999 of chi-square with 2 degrees of
    freedom. An observation without a match counts as one at the gate."""
    new_gate: Positive = 27.631
    """Squared Mahalanobis distance of a new landmark from every known one, at least: 0.999999 of chi-square."""
    pre_gate_m: Positive = 1.5
    """Only landmarks this near an observation are compared with it."""
    new_separation_m: NonNegative = 0.3
    """A new landmark is at least this far from every known one."""
    known_probability: Annotated[float, Range(0.0, 1.0, open_low=True)] = 1.0
    """A named observation outside this quantile of its innovation's distribution is a misread name; 1: never."""
    proposed_by: Literal["estimate", "scan-matching"] = "estimate"
    """Where the robot is when matches are chosen: by the estimator's prediction; or by scan matching, which is used
    for nothing else."""
    cull_below: Count = 3
    """A landmark with fewer observations than this 25 keyframes after its first one is removed; 0: none is."""


@dataclass(frozen=True)
class ScansConfig(Section):
    """Alignment of scans with earlier scans, and loop closures (front_end scan-matching)."""

    max_range_m: Positive = 30.0
    """Returns farther away are not used."""
    loop_closures: bool = True
    """Off: scans are linked to recent ones alone, and no loop is closed."""
    min_score: Annotated[float, Range(0.3, 1.0)] = 0.62
    """Least share of a submap's points that a loop closure must explain; lower finds more loop closures, and more wrong
    ones."""
    final_pass: bool = True
    """At the end align the scans between keyframes once more."""


@dataclass(frozen=True)
class ISAM2Config(Section):
    """The smoother (Kaess et al., IJRR 31(2), 2012)."""

    relinearize_threshold: Positive = 0.02
    """A variable that has moved farther than this, m or rad, is relinearized."""
    iterations: PositiveCount = 2
    """Gauss-Newton steps per update, at most; with one the smoother is overconfident where headings are uncertain."""
    robust: Literal["none", "huber", "cauchy"] = "none"
    """Loss on landmarks' factors, against wrong matches."""
    undo_probability: Annotated[float, Range(0.0, 1.0, open_low=True)] = 0.999999
    """A match is rejected later if its residual lies outside this quantile of its noise; 1: never."""
    least_gain: NonNegative = 0.02
    """A key pose is taken out of the graph whose observations say less than this of each landmark, nats; 0: none is."""


@dataclass(frozen=True)
class GridConfig(Section):
    """Hit grid and sense grid (report sections 4.4 and 4.5)."""

    cell_m: Annotated[float, Range(1e-3, 10.0)] = 0.05
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
    clearance_m: Annotated[float, Range(0.0, 10.0)] = 0.05
    """Added to the robot's radius when obstacles are inflated."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_hits > self.max_hits:
            raise InputError("min_hits", f"found {self.min_hits}", f"at most max_hits, {self.max_hits}")
