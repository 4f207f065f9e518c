"""Incremental smoothing with GTSAM's ISAM2: all key poses and landmarks at once (Kaess et al., IJRR 31(2), 2012)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from sixthsense.config import ISAM2Config
from sixthsense.core.covariance import check_covariance, chi_square_quantile
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmark_kernels import innovations_of, seen_from_each
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.parameters import P, ParameterEstimate
from sixthsense.core.se2 import move_covariance
from sixthsense.slam.estimators.base import (
    Estimate,
    LandmarkPrior,
    Link,
    check_links,
    check_observations,
    check_prior,
)
from sixthsense.slam.estimators.isam2_chain import NONE, Chain, Joined
from sixthsense.slam.estimators.isam2_factors import (
    Loss,
    exact_factor,
    graph_of,
    lines,
    link_factors,
    loss_of,
    motion_factor,
    prior_frames,
    prior_jacobians,
    seen_point,
    start_factor,
    to_pose,
    to_pose2,
    wall_factor,
    wall_frame,
)
from sixthsense.slam.estimators.isam2_solver import Kind, Solution, Solver, Unsolved, Variables

_REJECT_PERIOD = 10  # updates between two searches for outliers
_MAX_ITERATIONS = 20  # after links were added or removed: one that closes a loop moves all poses of the loop


class ISAM2:
    """A factor graph with one pose per update: a prior, odometry between poses, bearing and range to landmarks.

    A wall is a variable with a frame of its own (`isam2_factors.py`). GTSAM's tangent of a pose is in the robot's
    frame: covariances are rotated into it and out of it. Poses of updates without an observation are kept back until
    there is an observation or a link, since until then there is nothing to solve.
    """

    Options = ISAM2Config

    def __init__(self, start: Pose, start_cov: Array, config: ISAM2Config) -> None:
        """Start at `start` (world frame) with `start_cov` (3, 3), which may be zero; ValueError if that is invalid."""
        self._config = config
        self._links: dict[int, Link] = {}
        """between poses in the graph, by the number of its factor"""
        self._prior: PriorFactor | None = None
        self._solver = Solver(config)
        self._unsolved = Unsolved()
        self._poses = 0
        """number of poses, solved and waiting"""
        self._last_solved = 0
        """key of the last solved pose"""
        self._variables = Variables()
        self._chain = Chain()
        begin = start, check_covariance("start_cov", start_cov)
        self._solution = Solution(self._solver, self._variables, self._chain, begin)
        self._observations = Observations(self._variables, self._solution, loss_of(config))
        self._reject_gate = float(chi_square_quantile(config.undo_probability, 2))  # infinite for 1
        self.rejected = 0
        """matches rejected as outliers so far"""
        self._step = STANDSTILL
        """motion since the last pose, waiting or not"""
        self._pending = STANDSTILL
        """motion since the last solved pose"""

    def calibrate(self, prior: ParameterEstimate[Any]) -> None:
        """Add the parameters of the wheels, or of the sensor of points, as a variable of the graph."""
        self._solution.add(prior, self._unsolved, self._poses > 0 or self._pending is not STANDSTILL)

    def calibration(self, of: type[P]) -> ParameterEstimate[P] | None:
        """The parameters of this kind at the last solution, if they are estimated."""
        return self._solution.parameters(of)

    def start_from(self, prior: LandmarkPrior) -> None:
        """Begin with the landmarks of an earlier run: one factor of all of them."""
        check_prior(prior, bool(self._variables.keys) or self._poses > 0 or self._pending is not STANDSTILL)
        self._prior = PriorFactor.begun(prior, self._solver, self._variables)

    def predict(self, odometry: Odometry) -> None:
        """Move by an increment; it becomes part of the graph at the next update."""
        check_covariance("odometry", odometry.cov)
        if not odometry.is_standstill():
            self._step = self._step.then(odometry)
            self._pending = self._pending.then(odometry)

    def update(self, observations: Mapping[LandmarkId, Observation]) -> None:
        """Add the present pose and the observations from it; solve if there are any."""
        guess = self._solution.after(self._pending)
        if not observations:
            self._add_pose(guess)
            return
        check_observations(observations)
        is_spare = self._adds_nothing(guess, observations)
        self._add_pose(guess)
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
        attached = self._chain.attached(links)
        self._guess_by(attached)
        for factor in link_factors(attached):
            self._unsolved.graph.add(factor)
        guess = gtsam.Pose2(*self.poses_at([self._poses - 1])[0])
        ids = self._solve_waiting()[first:]
        self._links.update(zip(ids, attached, strict=True))
        self._solution.update(self._last_solved)
        off = guess.localCoordinates(to_pose2(self._solution.pose))
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
            self._variables.keys[i]  # KeyError before anything is removed
        if not gone:
            return
        factors = self._observations.factors(gone)
        if factors:
            self._remove(factors)
        self._prior = self._prior and self._prior.without(gone, self._solver, self._variables)
        self._variables.drop(gone)
        if self._solution.keys:
            self._solution.update(self._last_solved)

    def estimate(self) -> Estimate:
        """The pose with all motion so far, its covariance, and the landmarks' means."""
        pose, cov = self._solution.after(self._pending), self._solution.propagated(self._solution.cov(), self._pending)
        landmarks = self._solution.landmarks()
        return Estimate(pose, cov, landmarks.ids, landmarks.means.copy(), landmarks.walls)

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
        first = self._poses - len(self._unsolved.poses)
        known = [k for k in updates if k < first]
        solved = dict(zip(known, self._solution.poses_at(known), strict=True))
        rows = [solved[k] if k < first else self._unsolved.poses[k - first].triple() for k in updates]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    def relative_covariances(self, pairs: NDArray[np.int64]) -> Array:
        """(m, 3, 3) covariance of the pose at the second of two updates in the frame of that at the first, its axes.

        `pairs` (m, 2) are of solved poses; KeyError for an unknown one.
        """
        self.poses_at(pairs.ravel().tolist())
        self._solve_waiting()
        return np.array([self._solution.relative(*pair).cov for pair in pairs.tolist()]).reshape(-1, 3, 3)

    def graph_error(self) -> float:
        """Half the sum of squared whitened residuals of all factors at the present estimate (GTSAM's convention)."""
        return float(self._solver.isam.getFactorsUnsafe().error(self._solver.isam.calculateEstimate()))

    def _add_pose(self, guess: Pose) -> None:
        key = self._variables.add_pose(self._poses)
        self._unsolved.poses.append(guess)
        self._unsolved.values.insert(key, to_pose2(guess))
        if self._poses == 0:
            pose = self._solution.pose
            cov = move_covariance((0.0, 0.0, -pose.theta), self._solution.cov()[:3, :3])
            start = Odometry(pose, cov).then(self._pending)
            self._unsolved.graph.add(start_factor(key, start, self._solution.wheels is not None))
        else:
            self._unsolved.motions[self._poses] = self._step, self._unsolved.graph.size()
            self._unsolved.graph.add(motion_factor(key - 1, key, self._step, self._solution.wheels is not None))
        self._poses += 1
        self._step = STANDSTILL

    def _guess_by(self, links: Sequence[Link]) -> None:
        """Set the initial values of waiting poses by links to them, which are better than the odometry's."""
        first = self._poses - len(self._unsolved.poses)
        for link in links:
            if link.after >= first and link.after not in self._unsolved.guessed:
                guess = Pose(*self.poses_at([link.before])[0].tolist()) @ link.relative.motion
                self._unsolved.guessed.add(link.after)
                self._unsolved.poses[link.after - first] = guess
                self._unsolved.values.update(X(link.after), to_pose2(guess))

    def _solve_waiting(self, spare: Sequence[int] = (), gone: Sequence[int] = ()) -> list[int]:
        """Give the solver what waits, and take out spare poses and the factors `gone`; the factors of what waited."""
        waiting, joined = self._unsolved, Joined([], [], [])
        if spare:
            joined = self._chain.take_out(spare, self.poses_at, self._solution.wheels is not None)
            gone = [*gone, *joined.gone, *self._observations.drop_poses(spare)]
            for factor in joined.factors:
                waiting.graph.add(factor)
        last = None if waiting.poses else self._last_solved
        factors = self._solver.update(waiting.graph, waiting.values, sorted(gone), last)
        count = len(factors) - len(joined.followers)
        self._chain.solved(waiting.motions, factors)
        if joined.followers:
            self._chain.renumbered(joined.followers, factors[count:])
        # New ones each time: a factor that is sent twice counts twice.
        self._unsolved, self._pending, self._last_solved = Unsolved(), self._step, int(X(self._poses - 1))
        return factors[:count]

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
        if not least or self._solution.wheels is not None or not observations.keys() <= self._variables.keys.keys():
            return False
        return self._solution.map_gain(guess, observations, self._pending) < least

    def _converge(self) -> None:
        """Iterate until the newest pose stays: a loop that closes moves all of its poses, and weights of losses."""
        self._solver.converge(self._last_solved, 0.1 * self._config.relinearize_threshold, _MAX_ITERATIONS)
        self._solution.update(self._last_solved)

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
            ids, means = self._variables.ids, self._solution.landmarks().means
            squared, factors = self._observations.squared_residuals(self.trajectory(), ids, means)
            if not len(squared) or squared.max() <= self._reject_gate:
                return
            self._remove([int(factors[squared.argmax()])])
            self.rejected += 1


_FIELDS = (("pose", np.int64), ("id", np.int64), ("factor", np.int64), ("wall", np.bool_), ("first", np.bool_),
           ("z", np.float64, (2,)), ("cov", np.float64, (2, 2)))  # fmt: skip


class Observations:
    """The observations with the numbers of their factors, a row each, in the order of time."""

    def __init__(self, landmarks: Variables, solution: Solution, loss: Loss | None) -> None:
        self._variables, self._solution, self._loss = landmarks, solution, loss
        self._rows = np.zeros(256, dtype=list(_FIELDS))
        self._count = 0

    def add(self, pose: int, guess: Pose, observations: Mapping[LandmarkId, Observation], waiting: Unsolved) -> None:
        """Add the factors of what is observed from a pose to what waits, and the variables that they need."""
        self._solution.landmarks()  # as they are solved, before there are new ones
        for i, observation in observations.items():
            is_new = i not in self._variables.keys
            if is_new:
                self._add_landmark(i, guess, observation, waiting.values)
            waiting.graph.add(self._factor(i, (int(X(pose)), guess), observation, is_new, waiting.values))
            self._append(pose, i, observation, is_new)

    def _add_landmark(self, i: LandmarkId, guess: Pose, seen: Observation, values: gtsam.Values) -> None:
        """Add a landmark that is observed from `guess`, and its initial value to `values`."""
        if seen.is_wall:
            values.insert(self._variables.add_landmark(i, Kind.WALL), to_pose2(wall_frame(guess, seen)))
        else:
            bearing, distance, _ = seen.bearing_range()
            values.insert(self._variables.add_landmark(i, Kind.POINT), guess @ (distance * rotation(bearing)[:, 0]))

    def solved(self, factors: Sequence[int]) -> None:
        """Record the numbers of the factors that were added last."""
        self._rows["factor"][self._count - len(factors) : self._count] = factors

    def factors(self, ids: Collection[LandmarkId]) -> list[int]:
        """The factors of these landmarks, ascending."""
        rows = self._rows[: self._count]
        return sorted(rows["factor"][np.isin(rows["id"], list(ids))].tolist())

    def drop_poses(self, poses: Sequence[int]) -> list[int]:
        """Remove the observations from some poses; their factors."""
        if not poses:
            return []
        rows = self._rows[: self._count]
        factors: list[int] = rows["factor"][np.isin(rows["pose"], poses)].tolist()
        self.drop(factors)
        return factors

    def drop(self, factors: Collection[int]) -> None:
        """Remove the observations that have these factors."""
        rows = self._rows[: self._count]
        kept = rows[~np.isin(rows["factor"], list(factors))]
        self._rows[: len(kept)] = kept
        self._count = len(kept)

    def squared_residuals(self, poses: Array, ids: NDArray[np.int64], landmarks: Array) -> tuple[Array, Array]:
        """Squared Mahalanobis distances of all but each landmark's first observation, and their factors.

        `poses` (K, 3) world frame; `landmarks` (n, 2) are those of `ids` (n,).
        """
        rows = self._rows[: self._count]
        rows = rows[~rows["first"]]
        pose = poses[rows["pose"]]
        order = np.argsort(ids)
        landmark = landmarks[order[np.searchsorted(ids, rows["id"], sorter=order)]]
        z, cov, is_wall = (np.ascontiguousarray(rows[name]) for name in ("z", "cov", "wall"))
        off, cov = innovations_of(z, cov, seen_from_each(pose, landmark, is_wall), is_wall)
        return np.einsum("ni,ni->n", off, np.linalg.solve(cov, off[:, :, None])[:, :, 0]), rows["factor"]

    def _append(self, pose: int, i: LandmarkId, seen: Observation, is_first: bool) -> None:
        """Add a row; a first observation fixes its landmark, and stays where others contradict it."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._rows[self._count] = (pose, i, NONE, seen.is_wall, is_first, seen.z, seen.cov)
        self._count += 1

    def _factor(
        self, i: LandmarkId, pose: tuple[int, Pose], observation: Observation, is_new: bool, values: gtsam.Values
    ) -> gtsam.NonlinearFactor:
        key = self._variables.keys[i]
        if not observation.is_wall:
            return seen_point(key, pose[0], observation, self._solution.sensor, self._loss)
        if self._solution.wheels is not None and not is_new:
            return exact_factor(key, pose[0], observation, self._loss)
        frame = to_pose(values.atPose2(key)) if is_new else Pose.from_array(self._variables.frames[i])
        return wall_factor((key, frame), pose, observation, is_new, self._loss)


@dataclass(frozen=True, slots=True)
class PriorFactor:
    """The factor of earlier landmarks, in a graph, and what is left of them."""

    prior: LandmarkPrior
    frames: Mapping[LandmarkId, Array]
    """(3,) initial frame of each wall"""
    number: int
    """of the factor"""

    @classmethod
    def begun(cls, prior: LandmarkPrior, solver: Solver, landmarks: Variables) -> PriorFactor | None:
        """Add the landmarks, if there are any, to an empty solver, and to `landmarks`."""
        if not len(prior.ids):
            return None
        all_frames, frames = prior_frames(prior), {}
        means, axes = lines(all_frames)
        for k, i in enumerate(prior.ids.tolist()):
            is_wall = bool(prior.walls[k])
            landmarks.add_landmark(i, Kind.WALL if is_wall else Kind.POINT)
            landmarks.by_tangent[i] = axes[k] if is_wall else np.eye(2)
            if is_wall:
                frames[i] = landmarks.frames[i] = all_frames[k]
        landmarks.means = np.where(prior.walls[:, None], means, prior.landmarks)
        factor, values = _factor_of(prior, frames, landmarks)
        return cls(prior, frames, solver.update(graph_of(factor), values)[0])

    def without(self, ids: Collection[LandmarkId], solver: Solver, landmarks: Variables) -> PriorFactor | None:
        """Leave the marginal covariance of the landmarks that are not in `ids`; None if none is left."""
        if not np.isin(self.prior.ids, list(ids)).any():
            return self
        prior = self.prior.without(ids)
        if not len(prior.ids):
            solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [self.number])
            return None
        factor, _ = _factor_of(prior, self.frames, landmarks)
        number = solver.update(graph_of(factor), gtsam.Values(), [self.number])[0]
        return replace(self, prior=prior, number=number)


def _factor_of(
    prior: LandmarkPrior, frames: Mapping[LandmarkId, Array], landmarks: Variables
) -> tuple[gtsam.NonlinearFactor, gtsam.Values]:
    """The factor, and the earlier landmarks, about which it is quadratic.

    As a quadratic form it is eliminated in a third of the time that rows for all numbers of the landmarks take.
    """
    values, ids = gtsam.Values(), prior.ids.tolist()
    for i, mean in zip(ids, prior.landmarks, strict=True):
        values.insert(landmarks.keys[i], gtsam.Pose2(*frames[i]) if i in frames else mean)
    keys = [landmarks.keys[i] for i in ids]
    blocks = prior_jacobians(prior, np.array([frames.get(i, np.zeros(3)) for i in ids]))

    def whitened(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            for k, block in enumerate(blocks):
                jacobians[k] = block
        return np.zeros(len(blocks[0]))  # the landmarks are at their means

    exact = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(blocks[0])), keys, whitened).linearize(values)
    return gtsam.LinearContainerFactor(gtsam.HessianFactor(exact), values), values
