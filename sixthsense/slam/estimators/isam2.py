"""Incremental smoothing with GTSAM's ISAM2: all key poses and landmarks at once (Kaess et al., IJRR 31(2), 2012)."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy.linalg import block_diag

from sixthsense.config import ISAM2Config
from sixthsense.core.covariance import check_covariance, chi_square_quantile
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry, compose_jacobians
from sixthsense.core.se2 import between, move_covariance
from sixthsense.slam.estimators.base import Estimate, Link, check_links, check_observations
from sixthsense.slam.estimators.isam2_factors import (
    lines,
    link_factors,
    motion_factor,
    point_factor,
    to_pose,
    to_pose2,
    wall_factor,
    wall_frame,
)
from sixthsense.slam.estimators.isam2_graph import Chain, Graph, Kind, Step

_REJECT_PERIOD = 10  # updates between two searches for outliers
_MOST_SOLUTIONS = 20  # after links were added or removed


class _Seen(NamedTuple):
    """What the factor of an observation is of."""

    update: int
    landmark: LandmarkId
    is_first: bool
    """whether it fixes its landmark"""


class ISAM2:
    """A factor graph with one pose per update: a prior, odometry between poses, bearing and range to landmarks.

    A wall is a variable with a frame of its own (`isam2_factors.py`). GTSAM's tangent of a pose is in the robot's
    frame: covariances are rotated into it and out of it. Poses of updates without an observation are kept back until
    there is an observation or a link, since until then there is nothing to solve. Estimates and covariances are read
    when they are asked for: reading takes longer than most updates.
    """

    Options = ISAM2Config

    def __init__(self, start: Pose, start_cov: Array, config: ISAM2Config) -> None:
        """Start at `start` (world frame) with `start_cov` (3, 3), which may be zero; ValueError if that is invalid."""
        self._config, self._graph, self._chain = config, Graph(config), Chain()
        self._observed: dict[int, _Seen] = {}
        """by the number of the factor"""
        self._links: dict[int, Link] = {}
        """between poses in the graph, by the number of the factor"""
        self._poses = 0
        """number of poses, solved and waiting"""
        self._waiting: dict[int, Pose] = {}
        """guesses of the poses since the last solved one"""
        self._pose = start
        """the last solved one, or the start"""
        self._cov: Array | None = check_covariance("start_cov", start_cov)
        """(3, 3) of the last solved pose, world frame; None until it is asked for"""
        self._read: tuple[Array, Array] | None = np.zeros((0, 3)), np.zeros((0, 3))
        """all solved poses, and the landmarks; None until they are asked for"""
        self._reject_gate = float(chi_square_quantile(config.undo_probability, 2))  # infinite for 1
        self.rejected = 0
        """matches rejected as outliers so far"""
        self._step = STANDSTILL
        """motion since the last pose, waiting or not"""
        self._pending = STANDSTILL
        """motion since the last solved pose"""

    def predict(self, odometry: Odometry) -> None:
        """Move by an increment; it becomes part of the graph at the next update."""
        check_covariance("odometry", odometry.cov)
        if not odometry.is_standstill():
            self._step = self._step.then(odometry)
            self._pending = self._pending.then(odometry)

    def update(self, observations: Mapping[LandmarkId, Observation]) -> None:
        """Add the present pose and the observations from it; solve if there are any."""
        check_observations(observations)
        guess = self._pose @ self._pending.motion
        self._add_pose(guess)
        for i, observation in observations.items():
            is_first = i not in self._graph.keys
            factor = self._graph.add(self._factor(i, guess, observation, is_first))
            self._observed[factor] = _Seen(self._poses - 1, i, is_first)
        if observations:
            self._solve()
            self._graph.settle(
                self._last, self._config.relinearize_threshold, self._config.iterations - 1, to_pose2(guess)
            )
            self._solved()
            if self._poses % _REJECT_PERIOD == 0:
                self._reject_outliers()

    def link(self, links: Sequence[Link]) -> list[int]:
        """Add measured motions between the poses of updates, and solve; their ids."""
        check_links(links, self._poses)
        if not links:
            return []
        attached = [self._chain.attached(link) for link in links]
        self._guess_by(attached)
        ids = [self._graph.add(factor) for factor in link_factors(attached)]
        guess = gtsam.Pose2(*self.poses_at([self._poses - 1])[0])
        self._solve()
        self._links.update(zip(ids, attached, strict=True))
        if np.abs(guess.localCoordinates(to_pose2(self._pose))).max() > self._config.relinearize_threshold:
            self._converge()
        return ids

    def unlink(self, ids: Collection[int]) -> None:
        """Remove links, and solve."""
        for i in ids:
            self._links[i]  # KeyError before any is removed
        if ids:
            self._remove(ids)

    def take_out(self, updates: Sequence[int]) -> list[int]:
        """Take the poses of updates out of the graph, and solve; the ids of their links, which are lost."""
        if self._waiting:
            self._solve()
        gone, followers = self._chain.take_out(updates, self.poses_at)
        for pose in followers:
            step = self._chain.steps[pose]
            factor = self._graph.add(motion_factor([X(step.before), X(pose)], step.motion))
            self._chain.steps[pose] = step._replace(factor=factor)
        out = set(updates)
        lost = [i for i, link in self._links.items() if link.before in out or link.after in out]
        gone += [number for number, seen in self._observed.items() if seen.update in out]
        self._solve(self._dropped([*gone, *lost]))
        return lost

    def forget(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks with all factors of their observations, whose information about the poses is lost.

        Those of an earlier run stay in the graph, so that the others keep their marginal covariance.
        """
        gone = set(ids)
        for i in gone:
            self._graph.keys[i]  # KeyError before anything is removed
        for i in gone:
            del self._graph.keys[i]
        self._read = None
        factors = [number for number, seen in self._observed.items() if seen.landmark in gone]
        if factors:
            self._remove(factors)

    def estimate(self) -> Estimate:
        """The pose with all motion so far, its covariance, and the landmarks' means."""
        frames = self._solution()[1] if self._graph.keys else np.zeros((0, 3))
        ids = np.array(list(self._graph.keys), dtype=np.int64)
        walls = np.array([self._graph.is_wall(i) for i in self._graph.keys], dtype=np.bool_)
        means = np.where(walls[:, None], lines(frames)[0], frames[:, :2])
        return Estimate(self._pose @ self._pending.motion, self._propagated(self._pose_cov()), ids, means, walls)

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose and the landmarks asked for, in that order."""
        keys, cov = [self._graph.keys[i] for i in ids], self._pose_cov()
        if not keys:
            return self._propagated(cov)
        row = {i: k for k, i in enumerate(self._graph.keys)}
        _, axes = lines(self._solution()[1])
        blocks = [axes[row[i]] if self._graph.is_wall(i) else np.eye(2) for i in ids]
        # GTSAM answers in the order of the query, each variable in its own tangent.
        to_axes = block_diag(Pose(theta=self._pose.theta).adjoint(), *blocks)
        joint = to_axes @ self._graph.covariance([self._last, *keys]) @ to_axes.T
        joint[:3, :3] = cov
        return self._propagated(0.5 * (joint + joint.T))

    def trajectory(self) -> Array:
        """(K, 3), the pose at each update, smoothed with all observations so far."""
        return np.vstack([self._solution()[0], *(pose.array() for pose in self._waiting.values())])

    def poses_at(self, updates: Sequence[int]) -> Array:
        """(m, 3) the poses at some updates."""
        for k in updates:
            if not 0 <= k < self._poses:
                raise KeyError(f"updates: found {k}, allowed: 0 to {self._poses - 1}")
        if self._read is not None:
            return self.trajectory()[list(updates)]
        return np.array([self._pose_at(k).triple() for k in updates]).reshape(-1, 3)

    def relative_covariances(self, pairs: NDArray[np.int64]) -> Array:
        """(m, 3, 3) covariance of the pose at the second of two updates in the frame of that at the first, its axes."""
        self.poses_at(pairs.ravel().tolist())
        if self._waiting:
            self._solve()
        return np.array([self._relative(*pair).cov for pair in pairs.tolist()]).reshape(-1, 3, 3)

    @property
    def _last(self) -> int:
        """Key of the last solved pose."""
        return int(X(self._poses - len(self._waiting) - 1))

    def _add_pose(self, guess: Pose) -> None:
        k = self._poses
        key = self._graph.insert(int(X(k)), Kind.POSE, k, to_pose2(guess))
        if k == 0:
            cov = move_covariance((0.0, 0.0, -self._pose.theta), self._pose_cov())
            self._graph.add(motion_factor([key], Odometry(self._pose, cov).then(self._pending)))
        else:
            factor = self._graph.add(motion_factor([key - 1, key], self._step))
            self._chain.steps[k] = Step(k - 1, self._step, factor)
        self._waiting[k], self._poses, self._step = guess, k + 1, STANDSTILL

    def _factor(self, i: LandmarkId, guess: Pose, seen: Observation, is_first: bool) -> gtsam.NonlinearFactor:
        """The factor of an observation from the newest pose; a new landmark becomes a variable."""
        pose = int(X(self._poses - 1))
        if seen.is_wall:
            frame = wall_frame(guess, seen) if is_first else None
            key = self._graph.insert_landmark(i, Kind.WALL, to_pose2(frame)) if frame else self._graph.keys[i]
            at = frame or to_pose(self._graph.isam.calculateEstimatePose2(key))
            return wall_factor((key, at), (pose, guess), seen, is_first)
        if is_first:
            bearing, distance, _ = seen.bearing_range()
            self._graph.insert_landmark(i, Kind.POINT, guess @ (distance * rotation(bearing)[:, 0]))
        return point_factor(self._graph.keys[i], pose, seen)

    def _guess_by(self, links: Sequence[Link]) -> None:
        """Set the initial values of waiting poses by links to them, which are better than the odometry's."""
        guessed: set[int] = set()
        for link in links:
            if link.after in self._waiting and link.after not in guessed:
                guess = self._pose_at(link.before) @ link.relative.motion
                guessed.add(link.after)
                self._waiting[link.after] = guess
                self._graph.guess(link.after, guess)

    def _solve(self, gone: Sequence[int] = ()) -> None:
        """Solve with what waits, and without the factors `gone`."""
        self._graph.solve(gone, None if self._waiting else self._last)
        self._waiting, self._pending = {}, self._step
        self._solved()

    def _solved(self) -> None:
        """Read the newest pose of a new solution."""
        self._pose = to_pose(self._graph.isam.calculateEstimatePose2(self._last))
        self._cov = self._read = None

    def _converge(self) -> None:
        """Solve again until the last pose stays: a loop that closes moves all its poses, and weights of losses."""
        self._graph.settle(self._last, 0.1 * self._config.relinearize_threshold, _MOST_SOLUTIONS)
        self._solved()

    def _dropped(self, factors: Collection[int]) -> list[int]:
        """Some factors, without each other, which are no longer known as links or observations."""
        for number in factors:
            self._links.pop(number, None)
            self._observed.pop(number, None)
        return sorted(set(factors))

    def _remove(self, factors: Collection[int]) -> None:
        """Take factors of observations or links out of the graph, and solve."""
        self._solve(self._dropped(factors))
        self._converge()

    def _reject_outliers(self) -> None:
        """Remove the factors of matches that contradict all other factors, the largest residual first.

        At the solution the residual of a correct match is smaller than its noise, so the gate is conservative.
        First observations are kept: without it a wall's frame could slide along the wall.
        """
        while math.isfinite(self._reject_gate):
            factors, values = self._graph.isam.getFactorsUnsafe(), self._graph.isam.calculateEstimate()
            later = [number for number, seen in self._observed.items() if not seen.is_first]
            squares = {number: 2.0 * factors.at(number).error(values) for number in later}
            worst = max(squares, key=squares.__getitem__, default=None)
            if worst is None or squares[worst] <= self._reject_gate:
                return
            self._remove([worst])
            self.rejected += 1

    def _pose_at(self, update: int) -> Pose:
        """The pose of an update."""
        if update in self._waiting:
            return self._waiting[update]
        anchor, motion = self._chain.anchored(update)
        pose = to_pose(self._graph.isam.calculateEstimatePose2(X(anchor)))
        return pose if motion is STANDSTILL else pose @ motion.motion

    def _solution(self) -> tuple[Array, Array]:
        """(K, 3) all solved poses, and (n, 3) landmarks."""
        if self._read is None:
            kept, landmarks = self._graph.read()
            self._read = self._chain.all_poses(kept), landmarks
        return self._read

    def _pose_cov(self) -> Array:
        """(3, 3) of the last solved pose, world frame."""
        if self._cov is None:
            to_world = Pose(theta=self._pose.theta).adjoint()
            cov = to_world @ self._graph.covariance([self._last]) @ to_world.T
            self._cov = 0.5 * (cov + cov.T)
        return self._cov

    def _propagated(self, joint: Array) -> Array:
        """(3 + 2k, 3 + 2k) of the present pose and of k landmarks, from that of the last solved pose."""
        moved, motion = joint.copy(), self._pending
        if motion is STANDSTILL:
            return moved
        by_pose, by_motion = compose_jacobians(self._pose.theta, motion.motion)
        moved[:3] = by_pose @ moved[:3]
        moved[:, :3] = moved[:, :3] @ by_pose.T
        moved[:3, :3] += by_motion @ motion.cov @ by_motion.T
        return np.asarray(0.5 * (moved + moved.T))

    def _relative(self, before: int, after: int) -> Odometry:
        """A solved pose in the frame of another one, with what their errors have in common."""
        (first, to_first), (second, to_second) = self._chain.anchored(before), self._chain.anchored(after)
        motion, cov = Pose(), np.zeros((3, 3))
        if first != second:
            joint = self._graph.covariance([X(first), X(second)])
            motion = Pose(*between(*self.poses_at([first, second])))
            by_poses = np.hstack([-motion.inverse().adjoint(), np.eye(3)])  # each pose errs in its own axes
            cov = by_poses @ joint @ by_poses.T
        return to_first.inverse().then(Odometry(motion, 0.5 * (cov + cov.T))).then(to_second)
