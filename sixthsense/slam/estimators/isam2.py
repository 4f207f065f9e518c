"""Incremental smoothing with GTSAM's ISAM2: all key poses and landmarks at once (Kaess et al., IJRR 31(2), 2012)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from sixthsense.config import ISAM2Config
from sixthsense.core.covariance import check_covariance, chi_square_quantile
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.sensor import SensorEstimate
from sixthsense.core.wheels import WheelEstimate
from sixthsense.slam.estimators.base import (
    Estimate,
    LandmarkPrior,
    Link,
    check_links,
    check_observations,
    check_prior,
)
from sixthsense.slam.estimators.isam2_calibration import motion_factor, start_factor
from sixthsense.slam.estimators.isam2_chain import Chain
from sixthsense.slam.estimators.isam2_factors import link_factor, loss_of, to_pose2
from sixthsense.slam.estimators.isam2_observations import Observations
from sixthsense.slam.estimators.isam2_prior import PriorFactor
from sixthsense.slam.estimators.isam2_solution import Head, Solution
from sixthsense.slam.estimators.isam2_solver import Landmarks, Solver, Unsolved

_REJECT_PERIOD = 10  # updates between two searches for outliers
_MAX_ITERATIONS = 20  # after links were added or removed: one that closes a loop moves all poses of the loop


class ISAM2:
    """A factor graph with one pose per update: a prior, odometry between poses, bearing and range to landmarks.

    A wall is a variable with a frame of its own (`isam2_factors.py`). GTSAM's tangent of a pose is in the robot's
    frame: covariances are rotated into it and out of it. Poses of updates without an observation are kept back until
    there is an observation or a link, since until then there is nothing to solve.
    """

    def __init__(self, start: Pose, start_cov: Array, config: ISAM2Config) -> None:
        """Start at `start` (world frame) with `start_cov` (3, 3), which may be zero; ValueError if that is invalid."""
        self._config = config
        self._links: dict[int, Link] = {}
        """between poses in the graph, by the number of its factor"""
        self._prior = PriorFactor()
        self._solver = Solver(config)
        self._unsolved = Unsolved()
        self._poses = 0
        """number of poses, solved and waiting"""
        self._landmarks = Landmarks()
        self._head = Head(self._solver, start, check_covariance("start_cov", start_cov))
        self._chain = Chain()
        self._solution = Solution(self._solver, self._landmarks, self._head, self._chain)
        self._observations = Observations(self._solver, self._landmarks, self._head, loss_of(config))
        self._reject_gate = float(chi_square_quantile(config.undo_probability, 2))  # infinite for 1
        self.rejected = 0
        """matches rejected as outliers so far"""
        self._step = STANDSTILL
        """motion since the last pose, waiting or not"""
        self._pending = STANDSTILL
        """motion since the last solved pose"""

    def estimate_wheels(self, prior: WheelEstimate) -> None:
        """Add the wheels' parameters as a variable of the graph."""
        self._head.add_wheels(prior, self._unsolved, self._poses > 0 or self._pending is not STANDSTILL)

    def wheels(self) -> WheelEstimate | None:
        """The wheels' parameters at the last solution, if they are estimated."""
        return self._head.wheel_estimate()

    def estimate_sensor(self, prior: SensorEstimate) -> None:
        """Add the parameters of the sensor of points as a variable of the graph."""
        self._head.add_sensor(prior, self._unsolved, self._poses > 0 or self._pending is not STANDSTILL)

    def sensor(self) -> SensorEstimate | None:
        """The sensor's parameters at the last solution, if they are estimated."""
        return self._head.sensor_estimate()

    def start_from(self, prior: LandmarkPrior) -> None:
        """Begin with the landmarks of an earlier run: one factor of all of them."""
        check_prior(prior, bool(self._landmarks.keys) or self._poses > 0 or self._pending is not STANDSTILL)
        self._prior.start(prior, self._solver, self._landmarks)

    def predict(self, odometry: Odometry) -> None:
        """Move by an increment; it becomes part of the graph at the next update."""
        check_covariance("odometry", odometry.cov)
        if not odometry.is_standstill():
            self._step = self._step.then(odometry)
            self._pending = self._pending.then(odometry)

    def update(self, observations: Mapping[LandmarkId, Observation]) -> None:
        """Add the present pose and the observations from it; solve if there are any."""
        check_observations(observations)
        guess = self._head.pose @ self._head.motion(self._pending).motion
        is_spare = bool(observations) and self._adds_nothing(guess, observations)
        self._add_pose(guess)
        if not observations:
            return
        first = self._unsolved.graph.size()
        self._observations.add(self._poses - 1, guess, observations, self._unsolved)
        self._observations.solved(self._solve_waiting(self._chain.due())[first:])
        if is_spare:
            self._chain.spare(self._poses - 1)
        self._solver.relinearize(self._last_solved, guess)
        self._solution.update(self._last_solved)
        if self._poses % _REJECT_PERIOD == 0:
            self._reject_outliers()

    def link(self, links: Sequence[Link]) -> list[int]:
        """Add measured motions between the poses of updates, and solve; their ids."""
        check_links(links, self._poses)
        if not links:
            return []
        first = self._unsolved.graph.size()
        self._chain.keep({pose for link in links for pose in (link.before, link.after)})
        attached = [self._chain.attached(link) for link in links]
        for link in attached:
            self._guess_by(link)
            self._unsolved.graph.add(link_factor(X(link.before), X(link.after), link))
        guess = self._pose_at(self._poses - 1)
        ids = self._solve_waiting()[first:]
        self._links.update(zip(ids, attached, strict=True))
        self._solution.update(self._last_solved)
        off = to_pose2(guess).localCoordinates(to_pose2(self._head.pose))
        if np.abs(off).max() > self._config.relinearize_threshold:
            self._converge()
        return ids

    def unlink(self, ids: Collection[int]) -> None:
        """Remove links, and solve."""
        factors = self._dropped(ids)
        if factors:
            self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), factors)
            self._solution.update(self._last_solved)
            self._converge()

    def take_out(self, updates: Sequence[int]) -> list[int]:
        """Take the poses of updates out of the graph, and solve; the ids of their links, which are lost."""
        if self._unsolved.poses:
            self._solve_waiting()
            self._solution.update(self._last_solved)
        self._chain.check_takeable(updates)
        gone = set(updates)
        lost = [i for i, link in self._links.items() if link.before in gone or link.after in gone]
        self._solve_waiting(updates, self._dropped(lost))
        self._solution.update(self._last_solved)
        return lost

    def forget(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks with all their factors: their information about the poses is lost."""
        gone = set(ids)
        for i in gone:
            self._landmarks.keys[i]  # KeyError before anything is removed
        if not gone:
            return
        factors = self._observations.factors(gone)
        if factors:
            self._remove(factors)
        self._prior.forget(gone, self._solver, self._landmarks)
        self._landmarks.drop(gone)
        if self._head.is_solved:
            self._solution.update(self._last_solved)

    def estimate(self) -> Estimate:
        """The pose with all motion so far, its covariance, and the landmarks' means."""
        pose = self._head.pose @ self._head.motion(self._pending).motion
        cov = self._head.propagated(self._head.cov(), self._pending)
        landmarks = self._solution.landmarks()
        return Estimate(pose, cov, landmarks.ids(), landmarks.means.copy(), landmarks.walls())

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose and the landmarks asked for, in that order."""
        return self._solution.joint_covariance(ids, self._pending)

    def trajectory(self) -> Array:
        """(K, 3), the pose at each update, smoothed with all observations so far."""
        return np.vstack([self._solution.poses(), *(pose.array() for pose in self._unsolved.poses)])

    def poses_at(self, updates: Sequence[int]) -> Array:
        """(m, 3) the poses at some updates."""
        for k in updates:
            if not 0 <= k < self._poses:
                raise KeyError(f"updates: found {k}, allowed: 0 to {self._poses - 1}")
        poses = [self._pose_at(k) for k in updates]
        return np.array([(pose.x, pose.y, pose.theta) for pose in poses], dtype=np.float64).reshape(-1, 3)

    def graph_error(self) -> float:
        """Half the sum of squared whitened residuals of all factors at the present estimate (GTSAM's convention)."""
        return float(self._solver.isam.getFactorsUnsafe().error(self._solver.isam.calculateEstimate()))

    @property
    def _last_solved(self) -> int:
        return int(X(self._poses - 1 - len(self._unsolved.poses)))

    def _pose_at(self, k: int) -> Pose:
        first = self._poses - len(self._unsolved.poses)
        return self._solution.pose_at(k) if k < first else self._unsolved.poses[k - first]

    def _add_pose(self, guess: Pose) -> None:
        key = X(self._poses)
        self._unsolved.poses.append(guess)
        self._unsolved.values.insert(key, to_pose2(guess))
        if self._poses == 0:
            start = Odometry(self._head.pose, self._head.cov()[:3, :3]).then(self._pending)
            self._unsolved.graph.add(start_factor(key, start, self._head.wheels is not None))
        else:
            self._unsolved.motions[self._poses] = self._step, self._unsolved.graph.size()
            self._unsolved.graph.add(motion_factor(key - 1, key, self._step, self._head.wheels is not None))
        self._poses += 1
        self._step = STANDSTILL

    def _guess_by(self, link: Link) -> None:
        """Set the initial value of a waiting pose by a link to it, which is better than the odometry's."""
        first = self._poses - len(self._unsolved.poses)
        if link.after < first or link.after in self._unsolved.guessed:
            return
        guess = self._pose_at(link.before) @ link.relative.motion
        self._unsolved.guessed.add(link.after)
        self._unsolved.poses[link.after - first] = guess
        self._unsolved.values.update(X(link.after), to_pose2(guess))

    def _solve_waiting(self, spare: Sequence[int] = (), gone: Sequence[int] = ()) -> list[int]:
        """Give the solver what waits, and take out spare poses and the factors `gone`; the factors of what waited."""
        waiting = self._unsolved
        joined = self._chain.take_out(spare, self._pose_at, self._head.wheels is not None)
        for factor in joined.factors:
            waiting.graph.add(factor)
        last = None if waiting.poses else self._last_solved
        gone = sorted([*gone, *joined.gone, *self._observations.drop_poses(spare)])
        factors = self._solver.update(waiting.graph, waiting.values, gone, last)
        self._chain.solved(joined.followers, factors[len(factors) - len(joined.followers) :])
        for pose, (motion, at) in waiting.motions.items():
            self._chain.add(pose, motion, factors[at])
        # New ones each time: a factor that is sent twice counts twice.
        self._unsolved, self._pending = Unsolved(), self._step
        return factors[: len(factors) - len(joined.followers)]

    def _dropped(self, ids: Collection[int]) -> list[int]:
        """The factors of links, which are dropped, ascending; KeyError, before any is dropped, for an unknown one."""
        factors = sorted(set(ids))
        for i in factors:
            self._links[i]
        for i in factors:
            del self._links[i]
        return factors

    def _adds_nothing(self, guess: Pose, observations: Mapping[LandmarkId, Observation]) -> bool:
        """Whether the observations from a pose, of which there are some, say next to nothing of the landmarks."""
        least = self._config.least_gain
        if not least or self._head.wheels is not None or not observations.keys() <= self._landmarks.keys.keys():
            return False
        return self._solution.map_gain(guess, observations, self._pending) < least

    def _converge(self) -> None:
        """Iterate until no pose moves: a loop that closes moves all of its poses, and weights of losses with them."""
        for _ in range(_MAX_ITERATIONS):
            before = self._solution.poses()
            self._solver.iterate()
            self._solution.update(self._last_solved)
            shift = self._solution.poses() - before
            shift[:, 2] = wrap_angle(shift[:, 2])
            if np.abs(shift).max() <= 0.1 * self._config.relinearize_threshold:
                return

    def _remove(self, factors: list[int]) -> None:
        """Take factors of observations out of the graph and solve."""
        self._observations.drop(factors)
        self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), factors)
        self._solver.iterate(self._config.iterations - 1)
        self._solution.update(self._last_solved)

    def _reject_outliers(self) -> None:
        """Remove the factors of matches that contradict all other factors, the largest residual first.

        At the solution the residual of a correct match is smaller than its noise, so the gate is conservative.
        First observations are kept: without it a wall's frame could slide along the wall.
        """
        while True:
            ids, means = self._landmarks.ids(), self._solution.landmarks().means
            squared, factors = self._observations.squared_residuals(self.trajectory(), ids, means)
            if not len(squared) or squared.max() <= self._reject_gate:
                return
            self._remove([int(factors[squared.argmax()])])
            self.rejected += 1
