"""`Trace`, the record of a run: sensor data, estimates, plans, and the times of the loop's stages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sixthsense.config import Config
from sixthsense.config.parts import FRONT_ENDS
from sixthsense.core.covariance import landmark_covariances
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry
from sixthsense.core.source import Tick
from sixthsense.logs.log import Relations
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.simulation.scene import Scene
from sixthsense.slam.association.records import Association, Record
from sixthsense.slam.estimators import Estimate, Estimator
from sixthsense.slam.features import Features
from sixthsense.slam.front_end import Keyframe, LoopClosureCounts, PoseLinks
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Mapper
from sixthsense.slam.result import Step
from sixthsense.verdict.verdict import Verdict
from sixthsense.verdict.witnesses import Witnesses

STAGES = (
    "sense", "extract", "associate", "predict", "update", "grid", "plan", "track", "link", "loop_closure",
)  # fmt: skip


class Stopwatch:
    """Times the stages of the loop. The processing of a keyframe is the sum of its stages without sensing."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        """per keyframe, milliseconds per stage"""
        self.totals = dict.fromkeys(STAGES, 0.0)
        """per stage, milliseconds in the whole run"""
        self._row: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of a block that ends without an error to a stage; "sense" waits for a robot's messages, too."""
        began = time.perf_counter()
        yield
        elapsed = 1e3 * (time.perf_counter() - began)
        self._row[name] = self._row.get(name, 0.0) + elapsed
        self.totals[name] += elapsed

    def end_tick(self, is_keyframe: bool) -> None:
        """End a tick; the times of a tick with a keyframe are kept as a row."""
        if is_keyframe:
            self.rows.append(self._row)
        self._row = {}

    def keyframe_ms(self) -> Array:
        """(K,) processing time of each keyframe without sensing, milliseconds."""
        return np.array([sum(ms for stage, ms in row.items() if stage != "sense") for row in self.rows])


@dataclass(slots=True)
class Live:
    """`Trace.live`: valid during the call of `on_tick`; copy the values that you keep."""

    estimator: Estimator
    """the estimator, which computes the landmarks' covariances"""
    records: Mapping[LandmarkId, Record]
    """records of the landmarks in the estimate"""
    draw_map: Callable[[], Grid]
    """draws what is not in the map yet, as in a replay, and returns it"""
    mapper: Mapper
    """the keyframes of the map"""
    scan: Scan | None = None
    """the last scan, deskewed; robot's frame"""
    features: Features | None = None
    """features of the last keyframe; robot's frame"""
    since_cov: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """(3, 3) of the motion since the last keyframe, axes of the present pose"""
    verdict: Verdict | None = None
    """on the map so far, where someone asks for it"""

    def point_covariances(self, estimate: Estimate) -> Array:
        """(m, 2, 2) covariances of the m point landmarks of the latest estimate, world frame."""
        ids = estimate.ids[~estimate.walls].tolist()
        return landmark_covariances(self.estimator.joint_covariance(ids))


@dataclass(slots=True, repr=False)
class Trace:
    """The record of a run, filled by the loop; `Run.trace` of the results of `ss.run`, `ss.replay` and `ss.load`.

    Poses are (x, y, theta), world frame, metres and radians; stamps are nanoseconds.
    """

    config: Config
    scene: Scene | None
    """true scene; None for a log"""
    radius_m: float
    """radius of the robot"""
    stamps_ns: list[int] = field(default_factory=list)
    """per scan: record time"""
    log_stamps_s: list[float] = field(default_factory=list)
    """per scan: the log's own stamp, NaN in a simulated world"""
    estimates: list[Array] = field(default_factory=list)
    """per scan: (3,) pose estimated at that time"""
    odometry: list[Array] = field(default_factory=list)
    """per scan: (3,) dead-reckoned pose, world frame"""
    truths: list[Array] = field(default_factory=list)
    """per scan: (3,) true pose; empty for a log"""
    walkers: list[Array] = field(default_factory=list)
    """per scan: (N, 3) x, y and heading of people in the simulated building; empty without any"""
    touches: tuple[int, int] | None = None
    """how often the robot and a person touched, by the robot's fault and by the person's; None without people"""
    last_key: list[int] = field(default_factory=list)
    """per scan: index of the last keyframe, which may be the scan itself"""
    since_key: list[Array] = field(default_factory=list)
    """per scan: (3,) odometry since that keyframe"""
    since_covs: list[Array] = field(default_factory=list)
    """per scan: (3, 3) covariance of that motion when the scan was taken, axes of the scan's pose"""
    key_stamps_ns: list[int] = field(default_factory=list)
    """per keyframe: record time"""
    key_odometry: list[Odometry] = field(default_factory=list)
    """per keyframe: motion since the previous keyframe"""
    key_predicted: list[Estimate] = field(default_factory=list)
    """per keyframe: the pose before its update"""
    key_estimates: list[Estimate] = field(default_factory=list)
    """per keyframe: estimate after its update"""
    key_truths: list[Array] = field(default_factory=list)
    """per keyframe: (3,) true pose; empty for a log"""
    associations: list[Association] = field(default_factory=list)
    """per keyframe: matches, innovations and discarded observations"""
    walls_found: list[Array] = field(default_factory=list)
    """per keyframe: (W, 2, 2) extracted segments, robot's frame"""
    key_scans: list[Scan | None] = field(default_factory=list)
    """per keyframe: its scan, deskewed; of a run from its folder as the laser sent it"""
    key_measured: list[bool] = field(default_factory=list)
    """per keyframe: whether wheels have measured all of the motion to it"""
    stopwatch: Stopwatch = field(default_factory=Stopwatch)
    """per keyframe: stage times"""
    outcome: str = ""
    """why the run ended"""
    path_length_m: float = 0.0
    """length of the true path; by odometry for a log"""
    wall_time_s: float = 0.0
    """wall time of the loop"""
    plans: list[Array] = field(default_factory=list)
    """planned paths"""
    tours: list[Array] = field(default_factory=list)
    """(N, 2) robot, views and home of each tour by which an exploration chose a view"""
    plans_below_margin: int | None = None
    """number of plans with less than the desired margin to obstacles; None for a log"""
    plans_by_astar: int | None = None
    """number of plans by A* after the configured planner found none; None for a log and for A* itself"""
    guard_stops: int | None = None
    """number of times that the guard stopped the moving robot; None for a log"""
    left: list[UnseenPlace] = field(default_factory=list)
    """places that an exploration has not seen"""
    trajectory: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(K, 3) final pose at each keyframe"""
    final: Estimate = field(default_factory=lambda: Estimate.of_pose(Pose(), np.zeros((3, 3))))
    """estimate at the end of the run"""
    joint_cov: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """(3 + 2n, 3 + 2n) joint covariance of the final estimate"""
    records: dict[LandmarkId, Record] = field(default_factory=dict)
    """records of the landmarks in the final estimate"""
    culled: int = 0
    """number of removed landmarks"""
    walls_merged: int = 0
    """number of walls merged into duplicates that were observed more often"""
    loop_closures: LoopClosureCounts | None = None
    """what the search for old places has come to; None without one"""
    links: PoseLinks | None = None
    """links between keyframes by scan matching; None without them"""
    wheels: Array | None = None
    """(2, 3) the wheels' parameters at the end, in the order of `core.wheels.Wheels`, and their sigmas; if estimated"""
    sensor: Array | None = None
    """(2, 2) the same of the sensor of points, in the order of `core.sensor.Sensor`"""
    relations: Relations | None = None
    """hand-checked relations, the reference of the trajectory's error"""
    grid: Grid | None = None
    """the map; while a run goes on, as it was drawn last"""
    prior_map: Mapping[str, Any] | None = None
    """the prior map that the run began with: `name` and `digest`, `pose` if given, `pose_sigma`; None without one"""
    verdict: Verdict | None = None
    """whether the map is right, and what speaks against it; None while the run goes on"""
    name: str = ""
    """name of the scene, log or folder"""
    live: Live | None = None
    """current state of the loop, while it runs"""
    last_position: Array | None = None
    """(2,) position of the robot at the last tick, world frame: true, or by odometry for a log"""

    def draw_map(self) -> Grid | None:
        """The map with all keyframes so far: a replay draws none before its end, unless it is asked to."""
        return self.grid if self.live is None else self.live.draw_map()

    def add_tick(self, tick: Tick, odometry: Pose, is_carried: bool = False) -> None:
        """Add the distance driven since the last tick, if the robot was not carried.

        `odometry` is the dead-reckoned pose in the world frame.
        """
        here = tick.truth or odometry
        if self.last_position is not None and not is_carried:
            self.path_length_m += math.hypot(here.x - self.last_position[0], here.y - self.last_position[1])
        self.last_position = here.position

    def add_scan(self, tick: Tick, step: Step) -> None:
        """Record a scan after it was processed."""
        self.stamps_ns.append(tick.stamp_ns)
        self.log_stamps_s.append(np.nan if tick.log_stamp_s is None else tick.log_stamp_s)
        self.estimates.append(step.pose.array())
        self.odometry.append(step.dead_reckoned.array())
        if tick.truth is not None:
            self.truths.append(tick.truth.array())
        if tick.walkers is not None:
            self.walkers.append(tick.walkers)
            self.touches = tick.touches
        self.last_key.append(len(self.key_stamps_ns) - 1)
        self.since_key.append(step.since.motion.array())
        self.since_covs.append(step.since.cov)

    def add_keyframe(self, tick: Tick, keyframe: Keyframe, scan: Scan | None, is_measured: bool) -> None:
        """Record a keyframe after its update; `scan` is its own, and `is_measured` whether wheels measured the way."""
        self.key_odometry.append(keyframe.motion)
        self.key_stamps_ns.append(tick.stamp_ns)
        self.key_predicted.append(Estimate.of_pose(keyframe.predicted.pose, keyframe.predicted.pose_cov))
        self.key_estimates.append(keyframe.estimate)
        if tick.truth is not None:
            self.key_truths.append(tick.truth.array())
        self.associations.append(keyframe.association)
        self.walls_found.append(keyframe.features.walls)
        self.key_scans.append(scan)
        self.key_measured.append(is_measured)

    def carried_scans(self) -> list[int]:
        """Indices of the scans before which the robot was carried: no path leads there."""
        if self.config.no_odometry:
            return []  # a wide covariance is that of a guess
        keys = [k for k, motion in enumerate(self.key_odometry) if k and motion.is_carried()]
        return [self.last_key.index(k) for k in keys if k in self.last_key]

    def scan_poses(self) -> Array:
        """(S, 3) final pose of every scan: that of its last keyframe, composed with the odometry since then."""
        rows = [
            (Pose.from_array(self.trajectory[k]) @ Pose.from_array(motion)).array()
            for k, motion in zip(self.last_key, self.since_key, strict=True)
        ]
        return np.array(rows).reshape(-1, 3)

    def witnesses(self, last: int | None = None) -> Witnesses:
        """What the trace has of wheels, scans and estimate so far, or what it has of its `last` keyframes."""
        trajectory = self.trajectory if self.live is None else self.live.estimator.trajectory()
        count, last_key = len(trajectory), np.array(self.last_key, dtype=np.int64)
        first = 0 if last is None else max(0, count - last)
        keys = np.searchsorted(last_key, np.arange(first, count))
        scan = int(keys[0]) if first else 0
        is_scan = keys < len(last_key)
        is_scan[is_scan] = last_key[keys[is_scan]] == np.arange(first, count)[is_scan]
        has_final = self.live is None and min(self.last_key, default=-1) >= 0
        poses = self.scan_poses() if has_final else np.array(self.estimates[scan:], dtype=np.float64).reshape(-1, 3)
        matched = np.array([len(each.observations) for each in self.associations[first:]], dtype=np.int64)
        scans = tuple(self.key_scans[first:])
        return Witnesses(
            np.array(self.stamps_ns[scan:], dtype=np.int64),
            poses,
            None if self.config.no_odometry else np.array(self.odometry[scan:], dtype=np.float64).reshape(-1, 3),
            np.where(is_scan, keys - scan, -1),
            np.asarray(trajectory[first:], dtype=np.float64).reshape(-1, 3),
            np.array(self.key_measured[first:], dtype=np.bool_),
            scans if any(each is not None for each in scans) else (),
            None if self.links is None or first else self.links.ends,
            matched if matched.any() else None,
            self.loop_closures,
            "" if self.config.front_end in FRONT_ENDS.shipped else self.config.front_end,
        )

    def __repr__(self) -> str:
        of = f"{self.name or 'a run'}, {self.config.estimator}, {self.config.preset}, seed {self.config.seed}"
        return f"<Trace of {of}: {self.outcome or 'running'}, {len(self.stamps_ns)} scans>"
