"""The front end of scans: track, and on keyframes update, link, close loops."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.config.parts import KEEP_POSES
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.motion import STANDSTILL, Odometry, propagated
from sixthsense.core.se2 import (
    Triple,
    between,
    compose,
    conjugate,
    inverse,
    inverse_covariance,
    move_covariance,
    triple,
)
from sixthsense.slam.estimators import Estimate, Smoother
from sixthsense.slam.estimators.motion_source import LastVelocity, with_wheel_errors
from sixthsense.slam.front_end import Evidence, Finished, FrontEndSetup, Keyframe, LoopClosureCounts, is_due
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.graph import LINKS, REACH_M, ScanGraph
from sixthsense.slam.scans.known_places import of_last_metres
from sixthsense.slam.scans.links import private_covariance, reported
from sixthsense.slam.scans.loop_closures import LoopClosures
from sixthsense.slam.scans.place_search import place_search_of
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.tracking import (
    SLIP,
    SLIP_SIGMAS,
    TARGETS,
    Expected,
    LastScan,
    Tracked,
    WheelNoise,
    aligned,
    expected,
    search,
    track,
)


class ScanFrontEnd:
    """Aligns every scan with keyframes, and gives the estimator links between keyframes."""

    def __init__(self, setup: FrontEndSetup) -> None:
        """Begin at the start; InputError for an estimator that is no `Smoother`."""
        config, estimator, self.pose, _, self._sources, self._clock = setup
        """`T_world_robot` of the last scan, and the odometry since"""
        if not isinstance(estimator, Smoother):
            raise InputError("front_end", f"found scan-matching with {config.estimator}", KEEP_POSES)
        self._config, self._estimator = config, estimator
        self._store = ScanStore(config.scans.max_range_m)
        self._graph = ScanGraph(self._store, estimator, config.assumed.laser.range_m)
        self.loop_closures = LoopClosures(config.scans, self._graph, place_search_of(config))
        """the search for old places, with what it has found"""
        self._mount = Pose().triple()
        """`T_robot_laser`"""
        self._T_key_world = Pose()
        """of the robot at the last keyframe"""
        self._since = STANDSTILL
        """odometry of the robot since the last keyframe"""
        self._noise = WheelNoise()
        self._last = LastScan(np.zeros(3), Pose().triple(), Pose().triple())
        self._is_carried = False
        """whether the robot was carried since the last scan: what it saw before is no evidence of where it is"""
        self._lost: set[int] = set()
        """keyframes whose scans fitted nothing"""
        self._scans: list[TrackedScan] = []
        self._privates: dict[int, Array] = {}

    @property
    def since(self) -> Odometry:
        """Motion since the last keyframe, by the last scan and the odometry since."""
        motion = self._T_key_world @ self.pose if self._store.count else self._since.motion
        return Odometry(motion, self._for_estimator().cov)

    @property
    def counts(self) -> LoopClosureCounts | None:
        """What the search has come to so far; None where it is switched off."""
        return self.loop_closures.counts if self._config.scans.loop_closures else None

    @property
    def newest(self) -> int:
        """Index of the newest keyframe."""
        return self._store.count - 1

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
            expectation, tracked = self._tracked(scan)
        # Between keyframes the motion stays that of the wheels; one that nothing has measured becomes the aligned one.
        found = source.aligned(self._since, self._found(tracked)) if isinstance(source, LastVelocity) else self._since
        moved = self._T_key_world @ self.pose
        if not (self._is_carried or expectation is None or is_due(moved, self._since, self._config.keyframes)):
            self._since, self._last = found, self._last._replace(since=found.motion.triple())
            if self._config.scans.final_pass:
                # A copy, without the arrays that the scan has computed and keeps.
                self._scans.append(TrackedScan(dataclasses.replace(scan), self.newest, self._since, moved))
            return None
        motion = self._motion(tracked, moved)
        with self._clock("predict"):
            self._estimator.predict(motion)
        predicted = self._estimator.estimate()
        with self._clock("update"):
            self._estimator.update({})
            key = self._kept(expectation, tracked)
        with self._clock("link"):
            self._graph.link(key, self.loop_closures.near(key), self.loop_closures.latest)
        with self._clock("loop_closure"):
            self.loop_closures.look(key)
        estimate = self._reported(self._estimator.estimate())
        self.pose, self._since, self._T_key_world = estimate.pose, STANDSTILL, estimate.pose.inverse()
        self._last = LastScan(self._graph.poses[key].copy(), Pose().triple(), self._last.motion)
        if self._config.scans.final_pass:
            self._scans.append(TrackedScan(None, key, STANDSTILL, Pose()))
        return Keyframe(key, motion, predicted, estimate, loop_closures=self.counts)

    def finish(self) -> Finished:
        """Look for a loop closure, predict up to the last tick, and align the scans between keyframes once more."""
        motion = self.since
        if self._config.scans.loop_closures and self._store.count:
            with self._clock("loop_closure"):
                self.loop_closures.look_at_end()
        self._graph.refresh()
        key = self._reported(self._estimator.estimate())
        self._estimator.predict(motion)
        estimate = dataclasses.replace(self._estimator.estimate(), pose_cov=propagated(key.pose, key.pose_cov, motion))
        since_key = refined(self._graph, self._scans, self._mount) if self._config.scans.final_pass else None
        return Finished(estimate, since_key, self._graph.robot_links(self._graph.links), self.counts)

    def relative_covariances(self, pairs: NDArray[np.int64]) -> Array:
        """(m, 3, 3) covariance of the motion from each first keyframe to the second.

        With the private errors of their scans, which links do not have. `pairs` (m, 2) are of keyframes.
        """
        found = self._estimator.relative_covariances(pairs)
        own = {key: move_covariance(self._mount, self._private(key)) for key in np.unique(pairs).tolist()}
        first, second = (np.array(self._estimator.poses_at(keys.tolist())).reshape(-1, 3) for keys in pairs.T)
        for cov, (a, b), back in zip(found, pairs.tolist(), between(second, first), strict=True):
            cov += move_covariance(triple(back), own[a]) + own[b]
        return found

    def proposal(self) -> tuple[Array, Array]:
        """(K, 3) poses of all keyframes in the frame of the newest one, robot's frames, and (K, 3) their sigmas."""
        poses = compose(self._graph.poses, np.array(inverse(self._mount)))
        position, heading = self._graph.sigmas(self.newest)
        return between(poses[-1], poses), np.column_stack([position, position, heading])

    def _tracked(self, scan: Scan) -> tuple[Expected | None, Tracked | None]:
        """Track a scan against recent and linked keyframes; what was expected of it, and where it is found.

        Nothing is expected of the first scan, and none is found that is lost, or the first after the robot was carried.
        """
        row = self._store.put(scan)
        if not row:
            return None, None
        graph, source, since = self._graph, self._sources.present, self._since.motion.triple()
        cov = source.for_tracking(self._since).cov
        expectation = expected(graph.poses[-1], self._last, self._mount, since, cov, self._noise.factors)
        if self._is_carried:
            return expectation, None
        latest = range(max(graph.first, row - LINKS), row)
        # One that fitted nothing may have been seen from elsewhere than the wheels say: the next ones look past it.
        recent = ([key for key in latest if key not in self._lost] or list(latest))[1 - TARGETS :]
        targets = np.array([*recent, *graph.linked_old(recent[-1], recent[-1])[:1]])
        # Links that fit better than they state are no evidence that the next scan does.
        views = Views(self._store.returns, row, targets, graph.poses[targets], max(1.0, graph.factor))
        tracked = track(views, expectation.prior, expectation.starts, graph.usual, source.is_guess)
        if tracked.is_lost:
            near = of_last_metres(graph.travelled_m, self.newest)
            wide = views._replace(targets=near, at=graph.poses[near])
            tracked = max(
                tracked, search(wide, expectation.prior, graph.usual, source.is_guess), key=lambda t: t.log_odds
            )
        at = expectation.starts[0] if tracked.is_lost else tracked.pose
        self._last = LastScan(at, since, between(triple(self._last.pose), triple(at)))
        if tracked.is_lost:
            return expectation, None
        graph.usual = tracked.usual(graph.usual)
        self.pose = Pose.from_array(at) @ Pose(*inverse(self._mount))
        return expectation, tracked

    def _found(self, tracked: Tracked | None) -> Odometry | None:
        """The motion of the robot since the last keyframe as tracked."""
        if tracked is None:
            return None
        key = self._graph.poses[-1]
        motion = between(triple(key), triple(tracked.pose))
        cov = move_covariance(self._mount, move_covariance((0.0, 0.0, -float(tracked.pose[2])), tracked.cov))
        return Odometry(Pose(*conjugate(self._mount, motion)), cov)

    def _motion(self, tracked: Tracked | None, moved: Pose) -> Odometry:
        """The motion since the last keyframe: by odometry, or as tracked, `moved`, with the covariance of a slip.

        Where the scans say that the wheels have slipped, the links alone tell the motion.
        """
        if self._is_carried or not self._store.count:
            return self._since
        if tracked is not None and tracked.has_slipped:
            return Odometry(moved, self._since.cov + SLIP**2 * np.eye(3))
        motion = self._for_estimator()
        # Scans contradict it by this squared Mahalanobis distance.
        square = 0.0 if tracked is None else tracked.square
        return Odometry(motion.motion, motion.cov * (1.0 + square / SLIP_SIGMAS**2), motion.wheels)

    def _for_estimator(self) -> Odometry:
        """The motion since the last keyframe by odometry, with the errors that the run has shown its wheels to have."""
        if self._since.is_standstill():
            return self._since
        motion = self._sources.present.for_estimator(self._since)
        return Odometry(motion.motion, motion.cov * self._noise.factors, motion.wheels)

    def _kept(self, expectation: Expected | None, tracked: Tracked | None) -> int:
        """Keep the newest scan as the keyframe whose pose was added; its index."""
        graph, key = self._graph, self._store.keep()
        if expectation is not None and tracked is not None and not self._sources.present.is_guess:
            self._noise.update(expectation.stated, tracked.off, tracked.cov, float(expectation.prior.pose[2]))
        mount, is_carried, self._is_carried = np.array(self._mount), self._is_carried, False
        if is_carried:
            graph.first = key
        elif tracked is None and key:
            self._lost.add(key)
        graph.mount = mount
        graph.add(compose(self._estimator.poses_at([key])[0], mount) if tracked is None else tracked.pose)
        if expectation is not None:
            cov = inverse_covariance(expectation.prior.information) if tracked is None else tracked.cov
            if tracked is not None and tracked.has_slipped:
                half = 0.5 * tracked.off  # of the distance of the scans from the wheels is doubted
                cov = cov + np.outer(half, half)
            self.loop_closures.moved(cov, is_carried)
        return key

    def _reported(self, estimate: Estimate) -> Estimate:
        """An estimate at the newest keyframe, with the private errors of its scan and of the first one."""
        if self.newest < 1:
            return estimate
        poses = self._graph.poses
        cov = reported(estimate.pose_cov, poses[-1], self._private(self.newest), self._private(0), poses[0])
        return dataclasses.replace(estimate, pose_cov=cov)

    def _private(self, key: int) -> Array:
        """The private covariance of a keyframe's scan, which is computed once."""
        if key not in self._privates:
            self._privates[key] = private_covariance(self._store.returns, key, self._config.assumed.laser.range_m)
        return self._privates[key]


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
    store, poses, to_laser, back = graph.store, graph.poses, np.array(mount), np.array(inverse(mount))
    motions = np.array([each.motion.array() for each in scans]).reshape(-1, 3)
    for k, each in enumerate(scans):
        if each.scan is None:
            continue
        at = compose(poses[each.key], compose(compose(back, motions[k]), to_laser))
        references = np.arange(max(each.key - 1, 0), min(each.key + 2, len(poses)))
        references = references[np.hypot(*(poses[references] - at)[:, :2].T) < REACH_M]
        by_wheels = with_wheel_errors(each.odometry)
        cov = move_covariance((0.0, 0.0, float(at[2])), move_covariance(inverse(mount), by_wheels.cov))
        prior = Prior(at, inverse_covariance(cov), SLIP_SIGMAS)
        views = Views(store.returns, store.put(each.scan), references, poses[references], max(1.0, graph.factor))
        found = aligned(views, prior, at, 0.0).pose
        motions[k] = compose(compose(to_laser, between(poses[each.key], found)), back)
    return motions
