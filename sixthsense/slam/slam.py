"""SLAM, one tick at a time: from odometry and scans to an estimate and a map.

`Slam` neither drives the robot nor records the run. A simulated world, a log and a live robot feed it alike.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from sixthsense.config import Config, ConfigError
from sixthsense.config.names import NEEDS_FILTER
from sixthsense.config.platform import DEFAULT_ROBOT_RADIUS_M
from sixthsense.config.removed import OldName
from sixthsense.core.arguments import as_array, as_pose
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, Odometry, WheelOdometry, odometry
from sixthsense.core.sensor import SensorEstimate
from sixthsense.core.source import Tick
from sixthsense.core.wheels import WheelEstimate, wheel_prior
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import Estimate, Filter, make_estimator
from sixthsense.slam.features.deskew import Deskewer
from sixthsense.slam.front_end import Keyframe, LoopClosureCounts, Timed
from sixthsense.slam.front_ends import make_front_end
from sixthsense.slam.last_velocity import LastVelocity
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Mapper
from sixthsense.slam.mapping.straight_gaps import straight_gaps
from sixthsense.slam.moving import NOTHING_MOVES, Moving, MovingReturns
from sixthsense.slam.named_observations import NamedObservations
from sixthsense.slam.prior_map import PriorMap, begin_with
from sixthsense.slam.result import SlamResult, Step

__all__ = ["Keyframe", "Slam", "SlamResult", "Step", "Timed", "untimed"]


def untimed(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function as it is, not timed."""
    return function


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
        prior_map: PriorMap | None = None,
    ) -> None:
        """Begin at `start`, `T_world_robot`, of covariance `start_cov` (3, 3), exactly known by default.

        `radius_m` is of the disc that the robot is, by default the configuration's. `timed(stage, function)` returns
        the function that runs in its place, to measure stage times. `prior_map` is of an earlier run in this building,
        in whose frame the start is. Raises ConfigError for a configuration or start that it cannot be used with; the
        first scan raises PriorMapError if it does not fit the map.
        """
        self.config = config or Config()
        self._start = start or Pose()
        cov = np.zeros((3, 3)) if start_cov is None else start_cov
        self.estimator = make_estimator(self.config.estimator, self._start, cov, self.config.isam2)
        records = None if prior_map is None else prior_map.fresh_records()
        self._radius_m = radius_m or self.config.robot.radius or DEFAULT_ROBOT_RADIUS_M
        self._mapper = Mapper(self.config.grid, self._radius_m, self.config.safety.body_m)
        self.associator = Associator(self.config.association, records, self._mapper.are_free)
        self._deskew = Deskewer(self.config.features.deskew)
        self._moving = MovingReturns(self.config.grid.no_return_passes) if self.config.people else None
        self._wheels = self._make_wheels()
        self._named = NamedObservations(self.config, self.estimator, self._start)
        self._velocity = LastVelocity() if self.config.no_odometry else None
        self._unplaced = None if prior_map is None else (prior_map, cov)
        if prior_map is not None:
            begin_with(prior_map, self.config, self.estimator, self._start, cov)
            self._mapper.start_from(prior_map.evidence)
        self._front_end = make_front_end(
            self.config, self.estimator, self.associator, self._start, timed, self._velocity
        )
        self._odometry: Pose | None = None
        self._stamp_ns = 0
        self._T_world_odom = Pose()
        self._result: SlamResult | None = None
        self._fold = timed("predict", self._fold_odometry)
        self._map = timed("grid", self._mapped)
        self._blas = threadpool_limits(limits=1, user_api="blas")

    def __enter__(self) -> Slam:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give BLAS its threads back."""
        self._blas.restore_original_limits()

    def take(self, tick: Tick) -> Step:
        """Process a tick: its odometry always, its observations, and its scan if it is a keyframe."""
        increment, scan = self._fold(tick)
        tick = self._named.corrected(tick)
        still, moving = self._without_moving(scan, increment)
        is_matched = self.config.front_end == "scan-matching"
        taken = self._front_end.take(tick, still if is_matched else scan, self._placed(scan, increment))
        keyframe = self._named.keyframe(taken)
        if scan is not None and self._moving is not None:
            self._moving.keep(scan, self.pose, tick.stamp_ns)
        if keyframe is not None and self._wheels is not None:
            found = self.wheels()
            self._wheels.wheels = self._wheels.wheels if found is None else found.values
        if still is not None and keyframe is not None:
            self._map(still, keyframe, moving)
        return self._step(tick, increment, scan, keyframe, moving)

    def scan(self, stamp_ns: int, ranges: ArrayLike, odometry: Pose) -> Step:
        """Process a scan of the configured laser, for callers without a `Tick`.

        `ranges` (beams,) metres, counter-clockwise from `-laser.fov / 2`, inf or NaN where nothing was met; `odometry`
        is the robot's pose by its wheels, `T_odom_robot`, in any fixed frame; stamps ascend. Raises ValueError that
        names the argument for ranges of another shape, a pose that is not finite and a stamp that does not ascend.
        """
        laser = self.config.laser
        values = as_array("ranges", ranges, (laser.beams,), finite=False)
        return self.take(self._tick(stamp_ns, odometry, Scan.from_config(values, laser)))

    def odometry(self, stamp_ns: int, odometry: Pose) -> Step:
        """Process the robot's pose by its wheels between two scans, `T_odom_robot`; ValueError as of `scan`."""
        return self.take(self._tick(stamp_ns, odometry))

    @property
    def pose(self) -> Pose:
        """`T_world_robot` now: the last estimate, and the odometry since."""
        return self._front_end.pose

    revisits = OldName("revisits", "loop_closures")

    @property
    def loop_closures(self) -> LoopClosureCounts | None:
        """What the search for old places has come to so far; None for a front end that does not search."""
        return self._front_end.loop_closure_counts

    @property
    def grid(self) -> Grid:
        """The map."""
        return self._mapper.grid

    def estimate(self) -> Estimate:
        """Pose at the last keyframe (after `finish` at the last tick), its covariance, and the landmarks."""
        return self._named.reported(self.estimator.estimate())

    def trajectory(self) -> Array:
        """(K, 3) pose at each keyframe, as believed now."""
        return self.estimator.trajectory()

    def wheels(self) -> WheelEstimate | None:
        """The wheels' parameters at the last keyframe, if they are estimated."""
        return self.estimator.wheels() if isinstance(self.estimator, Filter) else None

    def sensor(self) -> SensorEstimate | None:
        """The parameters of the sensor of points at the last keyframe, if they are estimated."""
        return self._named.sensor()

    def finish(self) -> SlamResult:
        """Predict up to the last tick, and return what is known then. No tick can be taken after it."""
        if self._result is None:
            since_key = self._front_end.finish()
            estimate, trajectory = self.estimate(), self.trajectory()
            self._mapper.complete(trajectory)
            self._result = SlamResult(
                estimate,
                self._named.reported_joint(estimate, self.estimator.joint_covariance(estimate.ids.tolist())),
                trajectory,
                self.associator.records,
                self.associator.culled,
                self.associator.walls_merged,
                self._mapper.rebuilds,
                since_key,
                self.loop_closures,
                self.wheels(),
                self._front_end.links(),
                self.sensor(),
            )
        return self._result

    def _tick(self, stamp_ns: int, odometry: Pose, scan: Scan | None = None) -> Tick:
        if self._odometry is not None and stamp_ns <= self._stamp_ns:
            raise ValueError(f"stamp_ns: found {stamp_ns} after {self._stamp_ns}, allowed: ascending stamps")
        return Tick(stamp_ns, as_pose("odometry", odometry), scan)

    def _fold_odometry(self, tick: Tick) -> tuple[Odometry | None, Scan | None]:
        """The motion since the last tick, folded into that since the last keyframe; the scan, de-skewed by it."""
        if self._result is not None:
            raise RuntimeError("found a tick after finish, allowed: a new Slam")
        increment: Odometry | None = None
        if self._odometry is None:
            self._T_world_odom = self._start @ tick.odometry.inverse()
        else:
            increment = self._increment(self._odometry, tick)
        self._deskew.moved(tick.stamp_ns, increment or STANDSTILL)
        self._odometry, self._stamp_ns = tick.odometry, tick.stamp_ns
        return increment, None if tick.scan is None else self._deskew(tick.scan)

    def _without_moving(self, scan: Scan | None, increment: Odometry | None) -> tuple[Scan | None, Moving]:
        """The scan without the returns of what moves, if people may, and these.

        For the map and for scan matching: features take moving legs for what they are, something that hides a wall.
        """
        if scan is None or self._moving is None:
            return scan, NOTHING_MOVES
        return self._moving.split(scan, self.pose @ (increment or STANDSTILL).motion, self._stamp_ns)

    def _placed(self, scan: Scan | None, increment: Odometry | None) -> Odometry | None:
        """The increment; at the first scan also the motion from there to where the scan fits the prior map."""
        if scan is None or self._unplaced is None:
            return increment
        from sixthsense.slam.start_search import located

        (prior_map, cov), self._unplaced = self._unplaced, None
        motion = increment or STANDSTILL
        here = self.pose @ motion.motion
        found = located(scan, prior_map, here, cov, self.config.grid)
        return increment if found == here else motion.then(Odometry(here.inverse() @ found, np.zeros((3, 3))))

    def _make_wheels(self) -> WheelOdometry | None:
        """Odometry whose parameters the estimator estimates, if configured; ConfigError if it cannot."""
        if not self.config.calibrate_wheels:
            return None
        if not isinstance(self.estimator, Filter):
            raise ConfigError(f"calibrate_wheels: found true with {self.config.estimator}, allowed: {NEEDS_FILTER}")
        self.estimator.estimate_wheels(wheel_prior(self.config.assumed))
        return WheelOdometry(self.config.assumed)

    def _mapped(self, scan: Scan, keyframe: Keyframe, moving: Moving) -> None:
        walls = keyframe.features.walls
        if self.config.grid.walls:
            gaps = straight_gaps(scan, self.config.assumed.laser, self.config.grid.cell_m, 2.0 * self._radius_m)
            walls = np.concatenate([walls, gaps])
        self._mapper.add(self.trajectory, scan, walls, moving.standing_robot)

    def _step(
        self, tick: Tick, increment: Odometry | None, scan: Scan | None, keyframe: Keyframe | None, moving: Moving
    ) -> Step:
        dead_reckoned = self._T_world_odom @ tick.odometry
        since = self._front_end.since_keyframe, self._front_end.since_cov
        return Step(tick.stamp_ns, self.pose, dead_reckoned, increment, *since, scan, keyframe, self.grid, moving)

    def _increment(self, before: Pose, tick: Tick) -> Odometry:
        """The motion since the last tick, with the covariance that the log states or that of the assumed noise.

        Without odometry it is what the last velocity predicts.
        """
        duration_s = 1e-9 * (tick.stamp_ns - self._stamp_ns)
        if self._velocity is not None:
            return self._velocity.increment(self._front_end.since_keyframe, duration_s, tick.scan is not None)
        if tick.increment_cov is not None:
            return Odometry(before.inverse() @ tick.odometry, tick.increment_cov)
        if self._wheels is not None:
            return self._wheels.increment(before, tick.odometry, duration_s)
        return odometry(before, tick.odometry, self.config.assumed)
