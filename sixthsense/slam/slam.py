"""SLAM, one tick at a time: from odometry and scans to an estimate and a map.

`Slam` neither drives the robot nor records the run. A simulated world, a log and a live robot feed it alike.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from sixthsense.config import Config, LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.config.parts import ESTIMATORS, FRONT_ENDS, KEEP_POSES
from sixthsense.config.section import shown
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.config.tree import check_returned, part_of
from sixthsense.core.arguments import as_array, as_pose
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import MOST_RANGE_M, Scan
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.sensor import Sensor
from sixthsense.core.source import Tick, seconds
from sixthsense.core.wheels import Wheels
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import Estimate, Estimator, Filter, Smoother
from sixthsense.slam.estimators.base import check_estimate
from sixthsense.slam.estimators.motion_source import make_motion
from sixthsense.slam.estimators.sensor_calibration import SensorCalibration
from sixthsense.slam.features.deskew import Deskewer
from sixthsense.slam.front_end import Clock, Evidence, FrontEnd, FrontEndSetup, Keyframe, LoopClosureCounts, untimed
from sixthsense.slam.mapping.grid import NO_WALLS, Grid, Walls
from sixthsense.slam.mapping.mapper import Mapper
from sixthsense.slam.mapping.moving import NOTHING_MOVES, Moving, MovingReturns
from sixthsense.slam.mapping.straight_gaps import straight_gaps
from sixthsense.slam.prior_map import PriorMap, begin_with
from sixthsense.slam.result import SlamResult, Step


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
        clock: Clock = untimed,
        prior_map: PriorMap | None = None,
        draws_map: bool = True,
    ) -> None:
        """Begin at `start`, `T_world_robot`, of covariance `start_cov` (3, 3), exactly known by default.

        `radius_m` is of the disc that the robot is, by default the configuration's. `clock(stage)` is entered around
        each stage, to measure its time. `prior_map` is of an earlier run in this building, in whose frame the start is.
        Without `draws_map` keyframes are not drawn into the map before `draw_map` or `finish`, which saves time.
        Raises ValueError that names what is no configuration, no pose, or cannot be used; the first scan raises
        InputError if it does not fit the map.
        """
        if config is not None and not isinstance(config, Config):
            raise InputError("config", f"found {shown(config)}", "a Config, such as ss.preset()")
        self.config = config = config or Config()
        self._start, self._clock = Pose() if start is None else as_pose("start", start), clock
        cov = np.zeros((3, 3)) if start_cov is None else start_cov
        self._radius_m = config.robot.radius or DEFAULT_ROBOT_RADIUS_M if radius_m is None else radius_m
        self.estimator: Estimator = part_of(config, ESTIMATORS).make(self._start, cov)
        self._draws_map = draws_map
        self.mapper = Mapper(config.grid, self._radius_m)
        """the keyframes of the map"""
        records = None if prior_map is None else prior_map.fresh_records()
        self.associator = Associator(config.association, records, self.mapper.are_free)
        self._motion = make_motion(config, self.estimator)
        self._deskew = Deskewer(config.features.deskew)
        self._moving = MovingReturns(config.grid.no_return_passes) if config.people else None
        self._sensor = SensorCalibration(config, self.estimator, self._start)
        self._unplaced = None if prior_map is None else (prior_map, cov)
        if prior_map is not None:
            begin_with(prior_map, config, self.estimator)
            self.mapper.start_from(prior_map.evidence)
        setup = FrontEndSetup(config, self.estimator, self._start, self.associator, self._motion, clock)
        self._front_end: FrontEnd = part_of(config, FRONT_ENDS).make(setup)
        self._last: Tick | None = None
        self._T_world_odom = self._start
        self._estimate = self._sensor.reported(self.estimator.estimate())
        self.loop_closures: LoopClosureCounts | None = None
        """what the search for old places has come to so far; None for a front end that does not search"""
        self._result: SlamResult | None = None
        self._blas = threadpool_limits(limits=1, user_api="blas")

    def __enter__(self) -> Slam:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give BLAS its threads back."""
        self._blas.restore_original_limits()

    def take(self, tick: Tick) -> Step:
        """Process a tick: its odometry always, its observations, and its scan if it is a keyframe.

        Raises ValueError for a stamp that does not ascend, or a scan together with observations that name landmarks;
        RuntimeError after `finish`.
        """
        self._check(tick)
        with self._clock("predict"):
            increment = self._increment(tick)
            self._deskew.moved(tick.stamp_ns, increment or STANDSTILL)
            scan = None if tick.scan is None else self._deskew(tick.scan)
        placed, still, moving = increment, scan, NOTHING_MOVES
        guess = self.pose if scan is None or increment is None else self.pose @ increment.motion
        if scan is not None and self._moving is not None:
            # Not for features, which take moving legs for what they are: something that hides a wall.
            still, moving = self._moving.split(scan, guess, tick.stamp_ns)
        if scan is not None and self._unplaced is not None:
            placed = self._placed(scan, guess, increment)
        observations = self._sensor.corrected(tick.observations or {})
        keyframe = self._front_end.take(Evidence(placed, scan, still, observations, tick.closures))
        if keyframe is not None:
            keyframe = self._taken(keyframe)
            if still is not None:
                with self._clock("grid"):
                    self._add_to_map(still, keyframe, moving)
        pose, since, grid = self._front_end.pose, self._front_end.since, self.mapper.grid
        if scan is not None and self._moving is not None:
            self._moving.keep(scan, guess, pose, tick.stamp_ns)
        by_odometry = self._T_world_odom @ tick.odometry
        return Step(tick.stamp_ns, pose, by_odometry, increment, since, scan, keyframe, grid, moving)

    def scan(self, stamp_ns: int, ranges: ArrayLike, odometry: Pose) -> Step:
        """Process a scan of the configured laser, for callers without a `Tick`.

        `ranges` (beams,) metres, counter-clockwise from `-laser.fov / 2`, inf or NaN where nothing was met; `odometry`
        is the robot's pose by its wheels, `T_odom_robot`, in any fixed frame; stamps ascend. Raises ValueError that
        names the argument for ranges of another shape, for NaN alone, for ranges that can only be millimetres or
        centimetres, for a pose that is not finite and for a stamp that does not ascend.
        """
        laser = self.config.laser
        values = _as_ranges(ranges, laser)
        return self.take(Tick(stamp_ns, as_pose("odometry", odometry), Scan.from_config(values, laser)))

    def odometry(self, stamp_ns: int, odometry: Pose) -> Step:
        """Process the robot's pose by its wheels between two scans, `T_odom_robot`; raises what `scan` raises."""
        return self.take(Tick(stamp_ns, as_pose("odometry", odometry)))

    @property
    def pose(self) -> Pose:
        """`T_world_robot` now: the last estimate, and the odometry since."""
        return self._front_end.pose

    @property
    def grid(self) -> Grid:
        """The map, as it was drawn last."""
        return self.mapper.grid

    def draw_map(self) -> Grid:
        """Draw the keyframes that are not in the map yet, and return it."""
        with self._clock("grid"):
            return self.mapper.draw()

    def estimate(self) -> Estimate:
        """Pose at the last keyframe (after `finish` at the last tick), its covariance, and the landmarks."""
        return copy.deepcopy(self._estimate)

    def trajectory(self) -> Array:
        """(K, 3) pose at each keyframe, as believed now."""
        return self.estimator.trajectory()

    def relative_covariances(self, pairs: ArrayLike) -> Array:
        """How well keyframes are known relative to each other, as believed now.

        `pairs` (m, 2) are rows of `trajectory`. Returns (m, 3, 3): the covariance of x, y, heading of the second
        keyframe in the frame of the first, m and rad. Raises InputError for an estimator that cannot say it (filters),
        KeyError for an unknown keyframe.
        """
        rows = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
        if not isinstance(self.estimator, Smoother):
            raise InputError("estimator", f"found {self.config.estimator}", KEEP_POSES)
        # A front end may know of errors that the estimator does not.
        part = self._front_end if hasattr(self._front_end, "relative_covariances") else self.estimator
        return part.relative_covariances(rows)

    def wheels(self) -> ParameterEstimate[Wheels] | None:
        """The wheels' parameters at the last keyframe, if they are estimated."""
        return self.estimator.calibration(Wheels) if isinstance(self.estimator, Filter) else None

    def sensor(self) -> ParameterEstimate[Sensor] | None:
        """The parameters of the sensor of points at the last keyframe, if they are estimated."""
        return self._sensor.sensor()

    def finish(self) -> SlamResult:
        """Predict up to the last tick, and return what is known then. No tick can be taken after it."""
        if self._result is None:
            finished = self._front_end.finish()
            estimate = self._estimate = self._sensor.reported(finished.estimate)
            self.loop_closures = finished.loop_closures or self.loop_closures
            joint = self.estimator.joint_covariance(estimate.ids.tolist())
            # Links of scans have private errors, which the estimator does not know of.
            joint[:3, :3] = finished.estimate.pose_cov
            places = np.concatenate([estimate.pose.position, estimate.landmarks.ravel()])
            joint = self._sensor.reported_joint(places, joint)
            trajectory = self.trajectory()
            self.mapper.complete(trajectory)
            self._result = SlamResult(
                estimate,
                joint,
                trajectory,
                self.associator.records,
                self.associator.culled,
                self.associator.walls_merged,
                finished.since_key,
                self.loop_closures,
                self.wheels(),
                finished.links,
                self.sensor(),
            )
        return self._result

    def _check(self, tick: Tick) -> None:
        if self._result is not None:
            raise RuntimeError("found a tick after finish, allowed: a new Slam")
        if not isinstance(tick.stamp_ns, int | np.integer):
            raise ValueError(f"stamp_ns: found {shown(tick.stamp_ns)}, allowed: a whole number of nanoseconds")
        if self._last is not None and tick.stamp_ns <= self._last.stamp_ns:
            raise ValueError(f"stamp_ns: found {tick.stamp_ns} after {self._last.stamp_ns}, allowed: ascending stamps")
        if tick.scan is not None and tick.observations:
            raise ValueError("tick: found a scan and observations that name landmarks, allowed: one tick for each")

    def _increment(self, tick: Tick) -> Odometry | None:
        """The motion since the last tick; None at the first."""
        last, self._last = self._last, tick
        if last is None:
            self._T_world_odom = self._start @ tick.odometry.inverse()
            return None
        return self._motion.increment(last.odometry, tick, seconds(tick.stamp_ns - last.stamp_ns))

    def _placed(self, scan: Scan, here: Pose, increment: Odometry | None) -> Odometry | None:
        """The increment to the first scan, and the motion from there to where it fits the prior map."""
        from sixthsense.slam.relocalization import located

        assert self._unplaced is not None
        (prior_map, cov), self._unplaced = self._unplaced, None
        found = located(scan, prior_map, here, cov, self.config)
        if found == here:
            return increment
        return (increment or STANDSTILL).then(Odometry(here.inverse() @ found, np.zeros((3, 3))))

    def _taken(self, keyframe: Keyframe) -> Keyframe:
        """A keyframe with its covariance as it is reported; the wheels' newest values are used from now on."""
        if self.config.front_end not in FRONT_ENDS.shipped:
            name = f"front_end {self.config.front_end}"
            check_returned(name, "take", keyframe, Keyframe)
            check_returned(name, "pose", self._front_end.pose, Pose, x=(), y=(), theta=())
            check_returned(name, "since", self._front_end.since, Odometry, cov=(3, 3))
        self.check_estimate()
        keyframe = dataclasses.replace(keyframe, estimate=self._sensor.reported(keyframe.estimate))
        self._estimate, self.loop_closures = keyframe.estimate, keyframe.loop_closures
        self._motion.at_keyframe(self.wheels() if self.config.calibrate_wheels else None)
        return keyframe

    def check_estimate(self) -> None:
        """Raise PartError where an estimator that is not shipped returns what has another shape, or is not finite."""
        if self.config.estimator not in ESTIMATORS.shipped:
            check_estimate(self.config.estimator, self.estimator)

    def _add_to_map(self, scan: Scan, keyframe: Keyframe, moving: Moving) -> None:
        walls = NO_WALLS
        if self.config.grid.walls:
            gaps = straight_gaps(scan, self.config.assumed.laser, self.config.grid.cell_m, self._radius_m)
            walls = Walls(keyframe.features.walls, gaps)
        self.mapper.add(keyframe.index, self.estimator.trajectory, scan, walls, moving.standing_robot)
        if self._draws_map:
            self.mapper.draw()


def _as_ranges(value: ArrayLike, laser: LaserConfig) -> Array:
    """The ranges (beams,) of a scan, metres; inf and NaN are no returns.

    Raises ValueError for another shape, for NaN alone, and for a median that no laser and not this one reaches.
    """
    ranges = as_array("ranges", value, (laser.beams,), finite=False)
    if np.isnan(ranges).all():
        raise ValueError("ranges: expected metres, inf where nothing was met, got NaN alone")
    returns = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    returns = returns[returns < returns.max(initial=0.0)]  # the largest may be a code for no return
    if len(returns) and (median := float(np.median(returns))) > max(MOST_RANGE_M, laser.max_range):
        raise ValueError(f"ranges: expected metres, got a median of {median:.5g}: millimetres or centimetres")
    return ranges
