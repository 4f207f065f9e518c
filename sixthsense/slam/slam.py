"""SLAM, one tick at a time: from odometry and scans to an estimate and a map.

`Slam` neither drives the robot nor records the run. A simulated world, a log and a live robot feed it alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from sixthsense.config import AssumedConfig, Config
from sixthsense.config.platform import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, Odometry, odometry
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Tick
from sixthsense.slam.association.associator import Association, Associator, Record
from sixthsense.slam.estimators import Estimate, make_estimator
from sixthsense.slam.features import Features, extract
from sixthsense.slam.features.deskew import Deskewer
from sixthsense.slam.key_scans import KeyScans
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Mapper

Timed = Callable[[str, Callable[..., Any]], Callable[..., Any]]
"""From the name of a stage and its function to the function that runs in its place."""

_NO_WALLS = np.zeros((0, 2, 2))
_NO_WALLS.flags.writeable = False


@dataclass(frozen=True, slots=True)
class KeyScan:
    """What one key scan contributed."""

    motion: Odometry
    """since the key scan before"""
    estimate: Estimate
    """after the update"""
    association: Association
    """which sighting is of which landmark"""
    features: Features | None
    """robot's frame; None where the log itself gives the sightings"""

    @property
    def walls_robot(self) -> Array:
        """(W, 2, 2) wall segments, metres."""
        return _NO_WALLS if self.features is None else self.features.walls


@dataclass(frozen=True, slots=True)
class Step:
    """What `Slam.take` made of a tick."""

    stamp_ns: int
    """of the tick"""
    pose: Pose
    """`T_world_robot`: the last estimate, and the odometry since"""
    dead_reckoned: Pose
    """`T_world_robot` by odometry alone"""
    increment: Odometry | None
    """motion since the last tick; None at the first"""
    since_key_scan: Pose
    """motion since the last key scan"""
    scan: Scan | None
    """de-skewed"""
    key_scan: KeyScan | None
    """None where the tick brought no key scan"""
    grid: Grid
    """the map as it is now; the next key scan changes it"""


@dataclass(frozen=True, slots=True)
class SlamResult:
    """What is known after the last tick."""

    estimate: Estimate
    """at the last tick"""
    joint_cov: Array
    """(3 + 2n, 3 + 2n) of pose and landmarks, world frame"""
    trajectory: Array
    """(K, 3) final pose at each key scan"""
    landmark_records: Mapping[LandmarkId, Record]
    """sightings, kind and extent of each landmark of the estimate"""
    culled: int
    """landmarks removed"""
    walls_merged: int
    """walls merged into older duplicates"""
    rebuilds: int
    """times the grid was drawn again because key poses had moved"""


def untimed(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function as it is, not timed."""
    return function


class _Stages(NamedTuple):
    """The stages of a tick, in order; all but the first on key scans only."""

    fold_odometry: Callable[[Tick], tuple[Odometry | None, Scan | None]]
    predict: Callable[[Odometry], None]
    extract: Callable[[Scan], Features]
    associate: Callable[[Features | None, Tick], Association]
    update: Callable[[Association], Estimate]
    map: Callable[[Scan, Features], None]


class Slam:
    """Simultaneous localisation and mapping: features, association, estimator and map of one robot.

        with ss.Slam(config, start=Pose()) as slam:
            for tick in ticks:
                step = slam.take(tick)
            result = slam.finish()

    It keeps BLAS to one thread until `close`, which the `with` block calls: results differ between numbers of threads,
    and small matrices are slower with more.
    """

    def __init__(
        self,
        config: Config | None = None,
        start: Pose | None = None,
        *,
        start_cov: Array | None = None,
        radius_m: float | None = None,
        timed: Timed = untimed,
    ) -> None:
        """Begin at `start`, `T_world_robot`, of covariance `start_cov` (3, 3), exactly known by default.

        `radius_m` is of the disc that the robot is, by default the configuration's. `timed(stage, function)` returns
        the function that runs in its place, to measure stage times.
        """
        self.config = config or Config()
        self._pose = start or Pose()
        cov = np.zeros((3, 3)) if start_cov is None else start_cov
        self.estimator = make_estimator(self.config.estimator, self._pose, cov, self.config.isam2)
        self.associator = Associator(self.config.association)
        self._mapper = Mapper(self.config.grid, radius_m or self.config.robot.radius or DEFAULT_ROBOT_RADIUS_M)
        self._key_scans = KeyScans(self.config.keyscans)
        self._deskew = Deskewer(self.config.features.deskew)
        self._ransac_rng = random_streams(self.config.seed).ransac
        self._odometry: Pose | None = None
        self._stamp_ns = 0
        self._T_world_odom = Pose()
        self._result: SlamResult | None = None
        self._stages = _Stages(
            fold_odometry=timed("predict", self._fold_odometry),
            predict=timed("predict", self.estimator.predict),
            extract=timed("extract", self._extract),
            associate=timed("associate", self._associate),
            update=timed("update", self._update),
            map=timed("grid", self._map),
        )
        self._blas = threadpool_limits(limits=1, user_api="blas")

    def __enter__(self) -> Slam:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give BLAS its threads back."""
        self._blas.restore_original_limits()

    def take(self, tick: Tick) -> Step:
        """Process a tick: its odometry always, its sightings, and its scan if it is a key scan."""
        increment, scan = self._stages.fold_odometry(tick)
        if not self._key_scans.due(tick):
            return self._step(tick, increment, scan, None)
        motion = self._key_scans.take()
        self._stages.predict(motion)
        features = None if scan is None else self._stages.extract(scan)
        association = self._stages.associate(features, tick)
        estimate = self._stages.update(association)
        if scan is not None and features is not None:
            self._stages.map(scan, features)
        return self._step(tick, increment, scan, KeyScan(motion, estimate, association, features))

    def scan(self, stamp_ns: int, ranges: ArrayLike, odometry: Pose) -> Step:
        """Process a scan of the configured laser, for callers without a `Tick`.

        `ranges` (beams,) metres, counter-clockwise from `-laser.fov / 2`, inf or NaN where nothing was met; `odometry`
        is the robot's pose by its wheels, `T_odom_robot`, in any fixed frame; stamps ascend. Raises ValueError for
        another number of ranges, and for a stamp that does not ascend.
        """
        laser = self.config.laser
        values = np.asarray(ranges, dtype=np.float64)
        if values.shape != (laser.beams,):
            raise ValueError(f"ranges: expected shape ({laser.beams},), got {values.shape}")
        return self.take(self._checked(Tick(stamp_ns, odometry, Scan.from_config(values, laser))))

    def odometry(self, stamp_ns: int, odometry: Pose) -> Step:
        """Process the robot's pose by its wheels between two scans, `T_odom_robot`; ValueError as of `scan`."""
        return self.take(self._checked(Tick(stamp_ns, odometry)))

    @property
    def pose(self) -> Pose:
        """`T_world_robot` now: the last estimate, and the odometry since."""
        return self._pose

    @property
    def grid(self) -> Grid:
        """The map."""
        return self._mapper.grid

    def estimate(self) -> Estimate:
        """Pose at the last key scan (after `finish` at the last tick), its covariance, and the landmarks."""
        return self.estimator.estimate()

    def trajectory(self) -> Array:
        """(K, 3) pose at each key scan, as believed now."""
        return self.estimator.trajectory()

    def finish(self) -> SlamResult:
        """Predict up to the last tick, and return what is known then. No tick can be taken after it."""
        if self._result is None:
            self.estimator.predict(self._key_scans.take())
            estimate = self.estimate()
            self._mapper.complete()
            self._result = SlamResult(
                estimate,
                self.estimator.joint_covariance(estimate.ids.tolist()),
                self.trajectory(),
                self.associator.records,
                self.associator.culled,
                self.associator.walls_merged,
                self._mapper.rebuilds,
            )
        return self._result

    def _checked(self, tick: Tick) -> Tick:
        if self._odometry is not None and tick.stamp_ns <= self._stamp_ns:
            raise ValueError(f"stamp_ns: found {tick.stamp_ns} after {self._stamp_ns}, allowed: ascending stamps")
        return tick

    def _fold_odometry(self, tick: Tick) -> tuple[Odometry | None, Scan | None]:
        """The motion since the last tick, folded into that since the last key scan; the scan, de-skewed by it."""
        if self._result is not None:
            raise RuntimeError("found a tick after finish, allowed: a new Slam")
        increment: Odometry | None = None
        if self._odometry is None:
            self._T_world_odom = self._pose @ tick.odometry.inverse()
        else:
            increment = _increment(self._odometry, tick, self.config.assumed)
            self._key_scans.moved(increment)
            self._pose = self._pose @ increment.motion
        self._deskew.moved(tick.stamp_ns, increment or STANDSTILL)
        self._odometry, self._stamp_ns = tick.odometry, tick.stamp_ns
        return increment, None if tick.scan is None else self._deskew(tick.scan)

    def _extract(self, scan: Scan) -> Features:
        return extract(scan, self.config.assumed, self.config.features, self._ransac_rng)

    def _associate(self, features: Features | None, tick: Tick) -> Association:
        if features is None:
            return self.associator.known(tick.sightings or {}, self.estimator)
        return self.associator.associate(features.sightings, self.estimator)

    def _update(self, association: Association) -> Estimate:
        self.estimator.update(association.sightings)
        self.estimator.forget([*self.associator.cull(), *self.associator.merged(self.estimator)])
        estimate = self.estimate()
        self._pose = estimate.pose
        return estimate

    def _map(self, scan: Scan, features: Features) -> None:
        self._mapper.add(self.trajectory(), scan, features.walls)

    def _step(self, tick: Tick, increment: Odometry | None, scan: Scan | None, key_scan: KeyScan | None) -> Step:
        dead_reckoned = self._T_world_odom @ tick.odometry
        since = self._key_scans.since.motion
        return Step(tick.stamp_ns, self._pose, dead_reckoned, increment, since, scan, key_scan, self.grid)


def _increment(before: Pose, tick: Tick, assumed: AssumedConfig) -> Odometry:
    """The motion since the last tick, with the covariance that the log states, or else that of the assumed noise."""
    if tick.increment_cov is None:
        return odometry(before, tick.odometry, assumed)
    return Odometry(before.inverse() @ tick.odometry, tick.increment_cov)
