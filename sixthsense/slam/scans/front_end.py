"""The front end of scans: track, and on keyframes update, link, close loops."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.parts import KEEP_POSES, STATES_RELATIVE
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, Odometry, propagated
from sixthsense.core.se2 import (
    Triple,
    between,
    compose,
    conjugate,
    inverse,
    move_covariance,
    triple,
)
from sixthsense.slam.association.proposed import Proposal
from sixthsense.slam.estimators import Estimate, Smoother
from sixthsense.slam.estimators.base import StatesRelative
from sixthsense.slam.front_end import Clock, Evidence, Finished, FrontEndSetup, Keyframe, is_due
from sixthsense.slam.motion_source import LastVelocity, Motion, with_wheel_errors
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.graph import REACH_M, REACH_RAD, ScanGraph
from sixthsense.slam.scans.links import private_covariance, reported
from sixthsense.slam.scans.loop_closures import LoopClosures
from sixthsense.slam.scans.place_search import place_search_of
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.tracking import (
    NEAREST,
    SLIP_M,
    SLIP_RAD,
    SLIP_SIGMAS,
    Expected,
    LastScan,
    Tracked,
    WheelNoise,
    expected,
    informations_in_world,
    is_likelier,
    refine,
    search,
    track,
)

_RECENT, _OLD = 2, 1  # keyframes that a scan is tracked against, before it and of other passes


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
        self._config, self._estimator = config, estimator
        self.pose = start
        """`T_world_robot`: that of the last scan, and the odometry since"""
        self._has_final_pass = config.scans.final_pass and not is_guide
        self._store = ScanStore(config.scans.max_range_m)
        self._graph = ScanGraph(self._store, estimator, config.assumed.laser.range_m)
        self.loop_closures = LoopClosures(config.scans, self._graph, place_search_of(config))
        """the search for old places, with what it has found"""
        self.counts = self.loop_closures.counts if config.scans.loop_closures else None
        """what the search has come to so far; None where it is switched off"""
        self._mount = Pose().triple()
        """`T_robot_laser`"""
        self._T_key_world = Pose()
        """of the robot at the last keyframe"""
        self._since = STANDSTILL
        """odometry of the robot since the last keyframe"""
        self._noise = WheelNoise()
        self._expected: Expected | None = None
        """of the last scan; None before the second"""
        self._last = LastScan(np.zeros(3), Pose().triple(), Pose().triple())
        self._lost: set[int] = set()
        """keyframes whose scans have fitted nothing"""
        self._is_carried = False
        """whether the robot was carried since the last scan: what it saw before tells nothing of where it is"""
        self._scans: list[TrackedScan] = []
        self._first_private: Array | None = None
        """(3, 3) private covariance of the first scan, once there is one"""

    @property
    def since(self) -> Odometry:
        """Motion since the last keyframe, by the last scan and the odometry since."""
        motion = self._T_key_world @ self.pose if self._store.count else self._since.motion
        return Odometry(motion, self._for_estimator().cov)

    def take(self, evidence: Evidence) -> Keyframe | None:
        """Process a tick: every scan is tracked; keyframes are linked with earlier ones."""
        source, increment, scan = self._sources.present, evidence.increment, evidence.still
        if increment is not None:
            self._since = self._since.then(increment)
            self.pose = self.pose @ increment.motion
            self._is_carried |= not source.is_guess and increment.is_carried()
        if scan is None:
            return None
        self._mount = scan.T_robot_laser.triple()
        with self._clock("track"):
            tracked = self._tracked(scan)
        # An aligned scan is no reason to forget what wheels have measured.
        found = source.aligned(self._since, self._found(tracked)) if isinstance(source, LastVelocity) else self._since
        moved = self._T_key_world @ self.pose
        is_new = self._is_carried or not self._store.count
        if not (is_new or is_due(moved, self._since, self._config.keyframes)):
            self._since = found
            if self._has_final_pass:
                self._scans.append(TrackedScan(scan, self._graph.count - 1, self._since, moved))
            return None
        motion = self._motion(tracked, moved)
        with self._clock("predict"):
            self._estimator.predict(motion)
        predicted = self._estimator.estimate()
        with self._clock("update"):
            key = self._updated(tracked)
        with self._clock("link"):
            self.loop_closures.closings.link(key)
        if self._config.scans.loop_closures:
            with self._clock("loop_closure"):
                self.loop_closures.look(key)
            self.counts = self.loop_closures.counts
        return Keyframe(key, motion, predicted, self._stand_at_keyframe(), loop_closures=self.counts)

    def finish(self) -> Finished:
        """Predict up to the last tick, and align the scans between keyframes once more."""
        motion = self._for_estimator()
        key = self._reported(self._estimator.estimate())
        self._estimator.predict(motion)
        cov = propagated(key.pose, key.pose_cov, motion)
        estimate = dataclasses.replace(self._estimator.estimate(), pose_cov=cov)
        since_key = None
        if self._has_final_pass:
            since_key = refined(self._graph, self._scans, self._mount)
        return Finished(estimate, since_key, self._graph.robot_links(list(self._graph.links.values())))

    def relative_covariances(self, pairs: NDArray[np.int64]) -> Array:
        """(m, 3, 3) covariance of the motion from each first keyframe to the second, by the graph's variance factor.

        With the private errors of their scans, which links do not have. `pairs` (m, 2) are of keyframes; InputError for
        an estimator that cannot say it.
        """
        if not isinstance(self._estimator, StatesRelative):
            raise InputError("estimator", f"found {self._config.estimator}", STATES_RELATIVE)
        found = self._graph.variance_factor() * self._estimator.relative_covariances(pairs)
        returns, sigma_m = self._store.returns, self._config.assumed.laser.range_m
        own = {
            key: move_covariance(self._mount, private_covariance(returns, key, sigma_m))
            for key in np.unique(pairs).tolist()
        }
        first, second = (np.array(self._estimator.poses_at(keys.tolist())).reshape(-1, 3) for keys in pairs.T)
        for cov, (a, b), back in zip(found, pairs.tolist(), between(second, first), strict=True):
            cov += move_covariance(triple(back), own[a]) + own[b]
        return found

    @property
    def newest(self) -> int:
        """Index of the newest keyframe."""
        return self._store.count - 1

    def proposal(self) -> Proposal:
        """Where the robot is at the newest keyframe, relative to the others."""
        poses = compose(self._graph.poses, np.array(inverse(self._mount)))
        sigma_m, sigma_rad = self.loop_closures.sigmas(self.newest)
        return Proposal(between(poses[-1], poses), sigma_m, sigma_rad)

    def _tracked(self, scan: Scan) -> Tracked | None:
        """Track a scan against recent and linked keyframes; None for the first, also after the robot was carried."""
        row = self._store.put(scan)
        if not self._store.count:
            return None
        graph, last, source, since = self._graph, self._last, self._sources.present, self._since.motion.triple()
        cov = source.for_tracking(self._since).cov
        known = expected(graph.poses[-1], last, self._mount, since, cov, self._noise.factors)
        self._expected = known
        if self._is_carried:
            return None
        usual, is_guess = graph.usual, source.is_guess
        tracked: Tracked | None = None
        for recent in self._recent():
            found = track(self._views(row, recent), known.prior, known.starts, usual, is_guess)
            tracked = found if tracked is None or is_likelier(found, tracked) else tracked
            if tracked.is_firm:
                break
        assert tracked is not None
        if tracked.is_lost or (is_guess and tracked.is_doubted):
            near = self._views(row, self.loop_closures.of_last_metres(self.newest))
            found = search(near, known.prior, usual, is_guess)
            tracked = max(tracked, found, key=lambda each: each.log_odds)
        at = known.starts[0] if tracked.is_lost else tracked.pose
        self._last = LastScan(at, since, between(triple(last.pose), triple(at)))
        if tracked.is_lost:
            return None
        graph.usual = tracked.usual
        self.pose = Pose(*compose(triple(at), inverse(self._mount)))
        return tracked

    def _recent(self) -> Iterator[NDArray[np.int64]]:
        """The keyframes that a scan is tracked against: those of the newest that fitted others before it; then all.

        A scan that fits nothing may have been seen from elsewhere than the wheels say: the next ones look past it. They
        fit it and nothing else where the robot was carried.
        """
        newest, old = self._store.count, self._graph.linked_old(self._store.count - 1)[:_OLD]
        latest = [*range(max(self._graph.first, newest - _RECENT), newest)]
        fitting = [key for key in latest if key not in self._lost]
        for recent in [fitting, latest] if 0 < len(fitting) < len(latest) else [latest]:
            yield np.array([*recent, *old], dtype=np.int64)

    def _found(self, tracked: Tracked | None) -> Odometry | None:
        """The motion of the robot since the last keyframe as tracked."""
        if tracked is None:
            return None
        key = self._graph.poses[-1]
        motion = between(triple(key), triple(tracked.pose))
        cov = move_covariance(self._mount, move_covariance((0.0, 0.0, -tracked.pose[2]), tracked.cov))
        return Odometry(Pose(*conjugate(self._mount, motion)), cov)

    def _views(self, row: int, targets: NDArray[np.int64]) -> Views:
        return Views(self._store.returns, row, targets, self._graph.poses[targets], self._graph.scale())

    def _motion(self, tracked: Tracked | None, moved: Pose) -> Odometry:
        """The motion since the last keyframe: by odometry, or as tracked, `moved`, with the covariance of a slip.

        Where the scans say that the wheels have slipped, what the wheels say is no evidence. The links tell the rest.
        """
        if self._is_carried or not self._store.count:
            return self._since
        if tracked is not None and tracked.has_slipped:
            return Odometry(moved, self._since.cov + np.diag([SLIP_M, SLIP_M, SLIP_RAD]) ** 2)
        motion = self._for_estimator()
        # Scans have contradicted it by this squared Mahalanobis distance.
        slip = 0.0 if tracked is None else tracked.slip
        return Odometry(motion.motion, motion.cov * (1.0 + slip / SLIP_SIGMAS**2), motion.wheels)

    def _for_estimator(self) -> Odometry:
        """The motion since the last keyframe by odometry, with the errors that the run has shown its wheels to have."""
        if self._since.is_standstill():
            return self._since
        motion, factors = self._sources.present.for_estimator(self._since), self._noise.factors
        return Odometry(motion.motion, motion.cov * np.outer(factors, factors), motion.wheels)

    def _updated(self, tracked: Tracked | None) -> int:
        """Keep the newest scan as keyframe, and add its pose; its index. What it says of the wheels is learnt."""
        known, graph = self._expected, self._graph
        if tracked is not None and known is not None and not self._sources.present.is_guess:
            self._noise.measured(known.stated, tracked.off, tracked.cov, float(known.prior.pose[2]))
        self._estimator.update({})
        key, mount = self._store.keep(), np.array(self._mount)
        guess = compose(self._estimator.poses_at([key])[0], mount) if tracked is None else tracked.pose
        is_carried, self._is_carried = self._is_carried, False
        if is_carried:
            graph.first = key
        elif tracked is None and key:
            self._lost.add(key)
        graph.add(guess, mount)
        if known is not None:
            self.loop_closures.moved(key, tracked, known.prior.information, float(self._noise.factors[0]), is_carried)
        return key

    def _reported(self, estimate: Estimate) -> Estimate:
        """An estimate at the newest keyframe, by the graph's variance factor, with the private errors of its scans."""
        newest = self._graph.count - 1
        if newest < 1:
            return estimate
        returns, poses, sigma_m = self._store.returns, self._graph.poses, self._config.assumed.laser.range_m
        if self._first_private is None:
            self._first_private = private_covariance(returns, 0, sigma_m)
        own = private_covariance(returns, newest, sigma_m)
        cov = self._graph.variance_factor() * estimate.pose_cov
        return dataclasses.replace(estimate, pose_cov=reported(cov, poses[-1], own, self._first_private, poses[0]))

    def _stand_at_keyframe(self) -> Estimate:
        """Begin anew at the keyframe that was added; the estimate there."""
        estimate = self._reported(self._estimator.estimate())
        self.pose, self._since, self._T_key_world = estimate.pose, STANDSTILL, estimate.pose.inverse()
        self._last = LastScan(self._graph.poses[-1].copy(), Pose().triple(), self._last.motion)
        if self._has_final_pass:
            self._scans.append(TrackedScan(None, self._graph.count - 1, STANDSTILL, Pose()))
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


def refined(graph: ScanGraph, scans: list[TrackedScan], mount: Triple) -> Array:
    """(S, 3) motion of the robot from the last keyframe to each scan, by the poses of the graph's keyframes.

    About the tracked motion, with the errors of wheels in general: those of the run would hold scans where they were
    among keyframes that have moved since.
    """
    store, poses, factor = graph.store, graph.poses, graph.scale()
    motions = np.array([scan.motion.array() for scan in scans]).reshape(-1, 3)
    if not len(poses):
        return motions
    rows = np.array([k for k, scan in enumerate(scans) if scan.scan is not None], dtype=np.int64)
    if not len(rows):
        return motions
    keys = np.array([scans[k].key for k in rows])
    to_laser, back = np.array(mount), np.array(inverse(mount))
    found = compose(poses[keys], compose(compose(back, motions[rows]), to_laser))
    by_wheels = [with_wheel_errors(scans[k].odometry) for k in rows]
    covs = np.array([odometry.cov for odometry in by_wheels])
    odometry = np.array([odometry.motion.triple() for odometry in by_wheels])
    informations = informations_in_world(poses[keys], odometry, covs, mount)
    tree = cKDTree(poses[:, :2])
    is_aligned = np.zeros(len(rows), dtype=np.bool_)
    for i, k in enumerate(rows):
        # One scan at a time: the neighbours of all scans together would be the most memory of a replay.
        near = np.array(tree.query_ball_point(found[i, :2], REACH_M, return_sorted=True), dtype=np.int64)
        near = near[np.abs(wrap_angle(poses[near, 2] - found[i, 2])) < REACH_RAD]
        scan = scans[k].scan
        if len(near) < 2 or scan is None:
            continue
        references = near[np.argsort(np.abs(near - keys[i]), kind="stable")[:NEAREST]]
        views = Views(store.returns, store.put(scan), references, poses[references], factor)
        tracked = refine(views, Prior(found[i], informations[i], SLIP_SIGMAS))
        found[i], is_aligned[i] = tracked.pose, True
    rows, keys, found = rows[is_aligned], keys[is_aligned], found[is_aligned]
    motions[rows] = compose(compose(to_laser, between(poses[keys], found)), back)
    return motions


def scan_front_end(setup: FrontEndSetup) -> ScanFrontEnd:
    """The front end of scans; InputError for an estimator that cannot use it."""
    config, estimator, start, _, motion, clock = setup
    if not isinstance(estimator, Smoother):
        raise InputError("front_end", f"found scan-matching with {config.estimator}", KEEP_POSES)
    return ScanFrontEnd(config, estimator, start, motion, clock)
