"""The front end of scans: track, and on keyframes update, link, close loops."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.se2 import between, compose, composed_covariance, turned_covariance
from sixthsense.slam.association.proposed import Proposal
from sixthsense.slam.estimators import Estimate, Smoother
from sixthsense.slam.front_end import Clock, Evidence, Finished, Keyframe, LoopClosureCounts, is_due
from sixthsense.slam.motion_source import Motion, with_wheel_errors
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.graph import REACH_M, REACH_RAD, ScanGraph
from sixthsense.slam.scans.links import private_covariance, reported
from sixthsense.slam.scans.loop_closures import LoopClosures
from sixthsense.slam.scans.mount import Mount
from sixthsense.slam.scans.odometry_prior import informations_in_world, prior_of, weakened
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.tracking import NEAREST, SLIP_M, SLIP_RAD, SLIP_SIGMAS, Tracked, Usual, refine, search, track
from sixthsense.slam.scans.wheel_noise import WheelNoise

_RECENT, _OLD = 2, 1  # keyframes that a scan is tracked against, before it and of other passes


class _Last(NamedTuple):
    """The last scan, as tracked."""

    pose: Array
    """(3,) `T_world_laser`"""
    odometry: Pose
    """of the robot, since the last keyframe until then"""
    motion: Pose
    """of the laser, from the scan before to this one"""


class ScanFrontEnd:
    """Aligns every scan with keyframes, and gives the estimator links between keyframes."""

    def __init__(
        self,
        config: Config,
        estimator: Smoother,
        start: Pose,
        motion: Motion,
        clock: Clock,
        is_guide: bool = False,
    ) -> None:
        """Begin at `start`, `T_world_robot`; `is_guide` is whether only what it proposes is used, as it comes."""
        self._sources, self._clock = motion, clock
        self._config, self._estimator, self._pose = config, estimator, start
        self._has_final_pass = config.scans.final_pass and not is_guide
        self._store = ScanStore(config.scans.max_range_m)
        self._graph = ScanGraph(self._store, estimator, config.assumed.laser.range_m)
        self.loop_closures = LoopClosures(config.scans, self._graph)
        """the search for old places, with what it has found"""
        self._mount = Mount(Pose())
        self._T_key_world = Pose()
        """of the robot at the last keyframe"""
        self._since = STANDSTILL
        """odometry of the robot since the last keyframe"""
        self._noise = WheelNoise()
        self._prior: Prior | None = None
        """of the last scan; None before the second"""
        self._last: _Last | None = None
        self._is_carried = False
        """whether the robot was carried since the last scan: what it saw before tells nothing of where it is"""
        self._scans: list[TrackedScan] = []
        self._usual = Usual(0.0, 0.5)
        """what scans lately had"""

    @property
    def pose(self) -> Pose:
        """`T_world_robot`: that of the last scan, and the odometry since."""
        return self._pose

    @property
    def since(self) -> Odometry:
        """Motion since the last keyframe, by the last scan and the odometry since."""
        return Odometry(self._motion_since, self._sources.present.at_end(self._since).cov)

    @property
    def _motion_since(self) -> Pose:
        return self._T_key_world @ self._pose if self._store.count else self._since.motion

    def take(self, evidence: Evidence) -> Keyframe | None:
        """Process a tick: every scan is tracked; keyframes are linked with earlier ones."""
        self._move(evidence.increment)
        scan = evidence.still
        if scan is None:
            return None
        if scan.T_robot_laser != self._mount.T_robot_laser:
            self._mount = Mount(scan.T_robot_laser)
        with self._clock("track"):
            tracked = self._tracked(scan)
        found = self._sources.present.aligned(self._since, self._found(tracked))
        if not self._is_due():
            self._since = found
            self._keep(scan)
            return None
        motion = self._motion(tracked)
        if tracked is not None:
            self._learn_noise(tracked)
        with self._clock("predict"):
            self._estimator.predict(motion)
        predicted = self._estimator.estimate()
        with self._clock("update"):
            key = self._updated(tracked)
        with self._clock("link"):
            self.loop_closures.closings.link(key)
        with self._clock("loop_closure"):
            self._closed_loops(key)
        estimate = self._stand_at_keyframe()
        return Keyframe(key, motion, predicted, estimate, loop_closures=self.counts)

    def _move(self, increment: Odometry | None) -> None:
        if increment is not None:
            self._since = self._since.then(increment)
            self._pose = self._pose @ increment.motion
            self._is_carried |= self._sources.present.is_carried(increment)

    def _keep(self, scan: Scan | None) -> None:
        """Keep a scan, or the newest keyframe for None, for the final pass."""
        if self._has_final_pass:
            motion = STANDSTILL if scan is None else self._since
            self._scans.append(TrackedScan(scan, self.newest, motion, self._motion_since if scan else Pose()))

    @property
    def counts(self) -> LoopClosureCounts | None:
        """What the search for old places has come to so far; None where it is switched off."""
        return self.loop_closures.counts if self._config.scans.loop_closures else None

    def finish(self) -> Finished:
        """Predict up to the last tick, and align the scans between keyframes once more."""
        motion = self._sources.present.at_end(self._since)
        key = self._reported(self._estimator.estimate())
        self._estimator.predict(motion)
        to = motion.motion
        cov = composed_covariance(key.pose_cov, motion.cov, key.pose.theta, to.x, to.y)
        estimate = dataclasses.replace(self._estimator.estimate(), pose_cov=cov)
        since_key = None
        if self._has_final_pass:
            since_key = refined(self._store, self._graph.poses, self._scans, self._mount)
        return Finished(estimate, since_key, self._graph.robot_links())

    @property
    def newest(self) -> int:
        """Index of the newest keyframe."""
        return self._store.count - 1

    def proposal(self) -> Proposal:
        """Where the robot is at the newest keyframe, relative to the others."""
        laser, graph = self._mount, self._graph
        poses = compose(graph.poses, laser.T_laser_robot.array())
        sigma_m, sigma_rad = self.loop_closures.sigmas(self.newest)
        return Proposal(between(poses[-1], poses), sigma_m, sigma_rad)

    def _tracked(self, scan: Scan) -> Tracked | None:
        """Track a scan against recent and linked keyframes; None for the first, also after the robot was carried."""
        row = self._store.put(scan)
        if not self._store.count:
            return None
        poses, last = self._graph.poses, self._last
        prior = self._prior = prior_of(poses[-1], self._since_of_laser())
        if self._is_carried:
            return None
        assert last is not None
        step = self._mount.laser_motion(last.odometry.inverse() @ self._since.motion)
        before = Pose.from_array(last.pose)
        # By odometry; moving as before, where wheels are wrong; and standing, where they spin.
        motions = (step, last.motion, Pose())
        starts = compose(last.pose, np.array([(motion.x, motion.y, motion.theta) for motion in motions]))
        tracked = track(self._views(row, self._references()), prior, starts, self._usual)
        is_guess = self._sources.present.is_guess
        if tracked.is_lost(self._usual) or (is_guess and tracked.is_doubted(self._usual)):
            found = search(self._views(row, self.loop_closures.of_last_metres(self.newest)), prior, self._usual)
            tracked = max(tracked, found, key=lambda each: each.log_odds(self._usual))
            if tracked.is_lost(self._usual):
                self._last = _Last(starts[0], self._since.motion, step)
                return None
        tracked = tracked.remapped(prior) if is_guess else tracked
        self._usual = self._usual.with_scan(tracked)
        self._graph.usual_agreement = 1.0 - self._usual.contradicted
        self._last = _Last(tracked.pose, self._since.motion, before.inverse() @ Pose.from_array(tracked.pose))
        self._pose = self._mount.robot_pose(tracked.pose)
        return tracked

    def _found(self, tracked: Tracked | None) -> Odometry | None:
        """The motion since the last keyframe as tracked."""
        if tracked is None or self._prior is None:
            return None
        cov = np.asarray(np.linalg.inv(self._prior.information + tracked.information))
        key = self._graph.poses[-1]
        of_laser = Odometry(Pose.from_array(between(key, tracked.pose)), turned_covariance(cov, -key[2]))
        return self._mount.robot_odometry(of_laser)

    def _views(self, row: int, targets: NDArray[np.int64]) -> Views:
        return Views(self._store.returns, row, targets, self._graph.poses[targets])

    def _slipped(self, motion: Pose) -> Odometry:
        """A motion since the last keyframe with the covariance of a slip."""
        return Odometry(motion, self._since.cov + np.diag([SLIP_M, SLIP_M, SLIP_RAD]) ** 2)

    def _motion(self, tracked: Tracked | None) -> Odometry:
        """The motion since the last keyframe: by odometry, or as tracked with the covariance of a slip.

        Where the scans say that the wheels have slipped, what the wheels say is no evidence. The links tell the rest.
        """
        if self._is_carried or not self._store.count:
            return self._since
        if tracked is None:
            return self._noise.applied(self._sources.present.for_estimator(self._since))
        if tracked.has_slipped:
            return self._slipped(self._motion_since)
        motion = self._noise.applied(self._sources.present.for_estimator(self._since))
        return weakened(motion, tracked.slip)

    def _since_of_laser(self) -> Odometry:
        return self._mount.laser_odometry(self._noise.applied(self._sources.present.for_tracking(self._since)))

    def _learn_noise(self, tracked: Tracked) -> None:
        """Take in what the newest scan says of the wheels."""
        if self._sources.present.is_guess or self._prior is None:
            return
        heading = -float(self._graph.poses[-1, 2])
        left = np.linalg.inv(self._prior.information + tracked.information)
        off = np.append(rotation(heading) @ tracked.off[:2], tracked.off[2])
        stated = self._mount.laser_odometry(self._sources.present.for_tracking(self._since)).cov
        self._noise.measured(stated, off, turned_covariance(np.asarray(left), heading))

    def _references(self) -> NDArray[np.int64]:
        """Keyframes to track against."""
        newest = self._store.count
        recent = np.arange(max(self._graph.first, newest - _RECENT), newest)
        return np.concatenate([recent, self._graph.linked_old(newest - 1)[:_OLD]])

    def _is_due(self) -> bool:
        """Whether the newest scan is far enough from the last keyframe."""
        is_new = self._is_carried or not self._store.count
        return is_new or is_due(self._motion_since, self._since, self._config.keyframes)

    def _updated(self, tracked: Tracked | None) -> int:
        """Keep the newest scan as keyframe, and add its pose; its index."""
        self._estimator.update({})
        key = self._store.keep()
        guess = self._mount.laser_poses(self._estimator.poses_at([key])[0]) if tracked is None else tracked.pose
        is_carried, self._is_carried = self._is_carried, False
        if is_carried:
            self._graph.first = key
        self._graph.add(guess, self._mount)
        if self._prior is not None:
            self.loop_closures.moved(key, tracked, self._prior.information, float(self._noise.factors[0]), is_carried)
        return key

    def _closed_loops(self, key: int) -> None:
        """Look for old places."""
        if self._config.scans.loop_closures:
            self.loop_closures.look(key)

    def _reported(self, estimate: Estimate) -> Estimate:
        """An estimate at the newest keyframe, by the graph's variance factor, with the private errors of its scans."""
        if self.newest < 1:
            return estimate
        returns, poses, sigma_m = self._store.returns, self._graph.poses, self._config.assumed.laser.range_m
        own, first = (private_covariance(returns, key, sigma_m) for key in (self.newest, 0))
        cov = self._graph.variance_factor * estimate.pose_cov
        return dataclasses.replace(estimate, pose_cov=reported(cov, poses[-1], own, first, poses[0]))

    def _stand_at_keyframe(self) -> Estimate:
        """Begin anew at the keyframe that was added; the estimate there."""
        estimate = self._reported(self._estimator.estimate())
        self._pose, self._since, self._T_key_world = estimate.pose, STANDSTILL, estimate.pose.inverse()
        self._last = _Last(self._graph.poses[-1].copy(), Pose(), Pose() if self._last is None else self._last.motion)
        self._keep(None)
        return estimate


class TrackedScan(NamedTuple):
    """A scan and its place among the keyframes."""

    scan: Scan | None
    """None for a keyframe"""
    key: int
    """the last keyframe, which may be the scan itself"""
    odometry: Odometry
    """of the robot since then"""
    motion: Pose
    """of the robot since then, as tracked"""


def refined(store: ScanStore, poses: Array, scans: list[TrackedScan], mount: Mount) -> Array:
    """(S, 3) motion of the robot from the last keyframe to each scan; `poses` (K, 3) of keyframes, `T_world_laser`.

    About the tracked motion, with the errors of wheels in general: those of the run would hold scans where they were
    among keyframes that have moved since.
    """
    motions = np.array([scan.motion.array() for scan in scans]).reshape(-1, 3)
    if not len(poses):
        return motions
    rows = np.array([k for k, scan in enumerate(scans) if scan.scan is not None], dtype=np.int64)
    if not len(rows):
        return motions
    keys = np.array([scans[k].key for k in rows])
    found = compose(poses[keys], mount.laser_motions(motions[rows]))
    covs = np.array([mount.laser_odometry(with_wheel_errors(scans[k].odometry)).cov for k in rows])
    informations = informations_in_world(poses[keys], covs)
    around = cKDTree(poses[:, :2]).query_ball_point(found[:, :2], REACH_M, return_sorted=True)
    is_aligned = np.zeros(len(rows), dtype=np.bool_)
    for i, k in enumerate(rows):
        near = np.array(around[i], dtype=np.int64)
        near = near[np.abs(wrap_angle(poses[near, 2] - found[i, 2])) < REACH_RAD]
        scan = scans[k].scan
        if len(near) < 2 or scan is None:
            continue
        references = near[np.argsort(np.abs(near - keys[i]), kind="stable")[:NEAREST]]
        views = Views(store.returns, store.put(scan), references, poses[references])
        tracked = refine(views, Prior(found[i], informations[i], SLIP_SIGMAS))
        found[i], is_aligned[i] = tracked.pose, True
    rows, keys, found = rows[is_aligned], keys[is_aligned], found[is_aligned]
    motions[rows] = mount.robot_motions(between(poses[keys], found))
    return motions
