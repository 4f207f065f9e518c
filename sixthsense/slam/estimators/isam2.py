"""Incremental smoothing with GTSAM's ISAM2: all key poses and landmarks at once (Kaess et al., IJRR 31(2), 2012)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, W, X
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.stats import chi2

from sixthsense.config import ISAM2Config
from sixthsense.core.covariance import check_covariance
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import LandmarkId, Sighting
from sixthsense.core.motion import STANDSTILL, Odometry, compose_jacobians
from sixthsense.slam.estimators.base import Estimate, check_sightings
from sixthsense.slam.estimators.isam2_sightings import SightingFactors
from sixthsense.slam.estimators.isam2_solver import Solver
from sixthsense.slam.estimators.isam2_walls import lines, measurement, wall_frame

_FLOOR = 1e-6  # smallest sigma (m, rad) of a pose's factor: a certain motion or start would make the system singular
_REJECT_PERIOD = 10  # updates between two searches for outliers
_MAX_REJECTED = 5  # per search
_POINT = np.eye(2)  # a point's errors are those in GTSAM's tangent


@dataclass(slots=True)
class _Unsolved:
    """What the solver does not have yet."""

    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    poses: list[Pose] = field(default_factory=list)
    """of updates since the last solved one, by odometry"""


@dataclass(slots=True)
class _Landmarks:
    """Landmarks and their variables in the graph, in the order of the first sighting."""

    keys: dict[LandmarkId, int] = field(default_factory=dict)
    is_wall: dict[LandmarkId, bool] = field(default_factory=dict)
    by_tangent: dict[LandmarkId, Array] = field(default_factory=dict)
    """(2, 3) or (2, 2) Jacobian of a landmark by its variable's tangent in GTSAM"""
    means: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) at the last solution"""
    made: int = 0
    """number of landmarks so far, forgotten ones included"""

    def ids(self) -> NDArray[np.int64]:
        """(n,) of the landmarks."""
        return np.array(list(self.keys), dtype=np.int64)

    def walls(self) -> NDArray[np.bool_]:
        """(n,) which of them are walls."""
        return np.array(list(self.is_wall.values()), dtype=np.bool_)


class ISAM2:
    """A factor graph with one pose per update: a prior, odometry between poses, bearing and range to landmarks.

    A wall is a variable with a frame of its own (`isam2_walls.py`). GTSAM's tangent of a pose is in the robot's frame:
    covariances are rotated into it and out of it. Poses of updates without a sighting are kept back until the next
    update with one, since until then there is nothing to solve.
    """

    def __init__(self, start: Pose, start_cov: Array, config: ISAM2Config) -> None:
        """Start at `start` (world frame) with `start_cov` (3, 3), which may be zero; ValueError if that is invalid."""
        self._pose, self._pose_cov = start, check_covariance("start_cov", start_cov)
        """of the last solved pose, or the start"""
        self._config, self._loss = config, _loss(config)
        self._factors = SightingFactors()
        self._solver = Solver(config, self._factors.renumber)
        self._unsolved = _Unsolved()
        self._poses = 0
        """number of poses, solved and waiting"""
        self._landmarks = _Landmarks()
        self._reject_gate = float(chi2.ppf(config.undo_probability, 2))  # infinite for 1
        self.rejected = 0
        """matches rejected as outliers so far"""
        self._step = STANDSTILL
        """motion since the last pose, waiting or not"""
        self._pending = STANDSTILL
        """motion since the last solved pose"""
        self._solved = np.zeros((0, 3))
        """all solved poses"""

    def predict(self, odometry: Odometry) -> None:
        """Move by an increment; it becomes part of the graph at the next update."""
        check_covariance("odometry", odometry.cov)
        if not odometry.is_standstill():
            self._step = self._step.then(odometry)
            self._pending = self._pending.then(odometry)

    def update(self, sightings: Mapping[LandmarkId, Sighting]) -> None:
        """Add the present pose and the sightings from it; solve if there are any."""
        check_sightings(sightings)
        guess = self._pose @ self._pending.motion
        self._add_pose(guess)
        self._unsolved.poses.append(guess)
        self._poses += 1
        self._step = STANDSTILL
        if not sightings:
            return
        first = self._unsolved.graph.size()
        is_first = [i not in self._landmarks.keys for i in sightings]
        for (i, sighting), is_new in zip(sightings.items(), is_first, strict=True):
            if is_new:
                self._add_landmark(i, guess, sighting)
            add = self._wall_factor if sighting.is_wall else self._point_factor
            self._unsolved.graph.add(add(self._landmarks.keys[i], guess, sighting, is_new))
        places = self._solver.update(self._unsolved.graph, self._unsolved.values)
        for (i, sighting), place, is_new in zip(sightings.items(), places[first:], is_first, strict=True):
            self._factors.add(self._poses - 1, i, place, sighting, is_new)
        # New ones each time: a factor that is sent twice counts twice.
        self._unsolved = _Unsolved()
        self._pending = STANDSTILL
        self._relinearize(guess)
        self._read()
        if self._poses % _REJECT_PERIOD == 0:
            self._reject_outliers()

    def forget(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks with all their factors: their information about the poses is lost."""
        gone = set(ids)
        for i in gone:
            self._landmarks.keys[i]  # KeyError before anything is removed
        if not gone:
            return
        places = self._factors.places(gone)
        for i in gone:
            del self._landmarks.keys[i], self._landmarks.is_wall[i]
        self._remove(places)

    def estimate(self) -> Estimate:
        """The pose with all motion so far, its covariance, and the landmarks' means."""
        pose = self._pose @ self._pending.motion
        cov = self._propagated(self._pose_cov)
        landmarks = self._landmarks
        return Estimate(pose, cov, landmarks.ids(), landmarks.means.copy(), landmarks.walls())

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose and the landmarks asked for, in that order."""
        keys = [self._landmarks.keys[i] for i in ids]
        if not keys:
            return self._propagated(self._pose_cov)
        # GTSAM answers in the order of the query, each variable in its own tangent.
        joint = self._solver.joint_covariance([self._last_solved, *keys])
        to_world = block_diag(Pose(theta=self._pose.theta).adjoint(), *(self._landmarks.by_tangent[i] for i in ids))
        joint = to_world @ joint @ to_world.T
        joint[:3, :3] = self._pose_cov
        return self._propagated(0.5 * (joint + joint.T))

    def trajectory(self) -> Array:
        """(K, 3), the pose at each update, smoothed with all sightings so far."""
        return np.vstack([self._solved, *(pose.array() for pose in self._unsolved.poses)])

    def graph_error(self) -> float:
        """Half the sum of squared whitened residuals of all factors at the present estimate (GTSAM's convention)."""
        return float(self._solver.isam.getFactorsUnsafe().error(self._solver.isam.calculateEstimate()))

    @property
    def _last_solved(self) -> int:
        return int(X(self._poses - 1 - len(self._unsolved.poses)))

    def _add_pose(self, guess: Pose) -> None:
        key = X(self._poses)
        self._unsolved.values.insert(key, _pose2(guess))
        if self._poses == 0:
            noise = _gaussian(Odometry(guess, self._propagated(self._pose_cov)))
            self._unsolved.graph.add(gtsam.PriorFactorPose2(key, _pose2(guess), noise))
        else:
            noise = _gaussian(self._step)
            self._unsolved.graph.add(gtsam.BetweenFactorPose2(key - 1, key, _pose2(self._step.motion), noise))

    def _add_landmark(self, i: LandmarkId, guess: Pose, sighting: Sighting) -> None:
        landmarks, values = self._landmarks, self._unsolved.values
        landmarks.is_wall[i] = sighting.is_wall
        if sighting.is_wall:
            landmarks.keys[i] = W(landmarks.made)
            values.insert(landmarks.keys[i], _pose2(wall_frame(guess, sighting)))
        else:
            landmarks.keys[i] = L(landmarks.made)
            bearing, distance, _ = sighting.bearing_range()
            values.insert(landmarks.keys[i], guess @ (distance * rotation(bearing)[:, 0]))
        landmarks.made += 1

    def _point_factor(self, key: int, guess: Pose, sighting: Sighting, is_new: bool) -> gtsam.NonlinearFactor:
        bearing, distance, cov = sighting.bearing_range()
        noise = self._with_loss(_noise(cov))
        return gtsam.BearingRangeFactor2D(X(self._poses - 1), key, gtsam.Rot2(bearing), distance, noise)

    def _wall_factor(self, key: int, guess: Pose, sighting: Sighting, is_new: bool) -> gtsam.NonlinearFactor:
        frame = wall_frame(guess, sighting) if is_new else _pose(self._solver.isam.calculateEstimatePose2(key))
        place, root = measurement(guess, frame, sighting, is_new)
        noise = self._with_loss(gtsam.noiseModel.Gaussian.SqrtInformation(root))
        return gtsam.BetweenFactorPose2(key, X(self._poses - 1), _pose2(place), noise)

    def _with_loss(self, noise: gtsam.noiseModel.Gaussian) -> gtsam.noiseModel.Base:
        return noise if self._loss is None else gtsam.noiseModel.Robust.Create(self._loss, noise)

    def _relinearize(self, guess: Pose) -> None:
        """Iterate while the newest pose is farther than the threshold from its linearization point."""
        linearized = _pose2(guess)
        for _ in range(self._config.iterations - 1):
            solved = self._solver.isam.calculateEstimatePose2(self._last_solved)
            if np.abs(linearized.localCoordinates(solved)).max() <= self._config.relinearize_threshold:
                return
            self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values())
            linearized = solved

    def _remove(self, places: list[int]) -> None:
        """Take factors out of the graph and solve."""
        self._factors.drop(places)
        self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), places)
        for _ in range(self._config.iterations - 1):
            self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values())
        self._read()

    def _reject_outliers(self) -> None:
        """Remove the factors of matches that contradict all other factors, the largest residual first.

        At the solution the residual of a correct match is smaller than its noise, so the gate is conservative.
        First sightings are kept: without it a wall's frame could slide along the wall.
        """
        for _ in range(_MAX_REJECTED):
            ids, means = self._landmarks.ids(), self._landmarks.means
            squared, places = self._factors.squared_residuals(self.trajectory(), ids, means)
            if not len(squared) or squared.max() <= self._reject_gate:
                return
            self._remove([int(places[squared.argmax()])])
            self.rejected += 1

    def _read(self) -> None:
        """Read poses, the last one's covariance and the landmarks from the solver."""
        values = self._solver.isam.calculateEstimate()
        frames = np.asarray(gtsam.utilities.extractPose2(values)).reshape(-1, 3)
        points = np.asarray(gtsam.utilities.extractPoint2(values)).reshape(-1, 2)
        is_wall = self._landmarks.walls()
        # In the order of their keys: the letter of walls comes before that of poses, then the number.
        walls, self._solved = np.split(frames, [np.count_nonzero(is_wall)])
        means, axes = lines(walls)
        self._landmarks.means = np.empty((len(is_wall), 2))
        self._landmarks.means[is_wall], self._landmarks.means[~is_wall] = means, points
        of_walls = iter(axes)
        self._landmarks.by_tangent = {
            i: next(of_walls) if wall else _POINT for i, wall in self._landmarks.is_wall.items()
        }
        self._pose = Pose.from_array(self._solved[-1])
        turn = Pose(theta=self._pose.theta).adjoint()
        cov = turn @ self._solver.covariance(self._last_solved) @ turn.T
        self._pose_cov = 0.5 * (cov + cov.T)

    def _propagated(self, joint: Array) -> Array:
        """Joint covariance (n, n) of the last update's pose and landmarks, propagated by the motion since; a copy."""
        if self._pending is STANDSTILL:
            return joint.copy()
        phi, g = compose_jacobians(self._pose.theta, self._pending.motion)
        moved = joint.copy()
        moved[:3] = phi @ moved[:3]
        moved[:, :3] = moved[:, :3] @ phi.T
        moved[:3, :3] += g @ self._pending.cov @ g.T
        return 0.5 * (moved + moved.T)


def _pose(pose: gtsam.Pose2) -> Pose:
    return Pose(pose.x(), pose.y(), pose.theta())


def _pose2(pose: Pose) -> gtsam.Pose2:
    return gtsam.Pose2(pose.x, pose.y, pose.theta)


def _gaussian(motion: Odometry) -> gtsam.noiseModel.Gaussian:
    return _noise(motion.cov_after() + _FLOOR**2 * np.eye(3))


def _noise(cov: Array) -> gtsam.noiseModel.Gaussian:
    # By default GTSAM takes a covariance whose off-diagonals are below 1e-9 for a diagonal one.
    return gtsam.noiseModel.Gaussian.Covariance(cov, False)


def _loss(config: ISAM2Config) -> gtsam.noiseModel.mEstimator.Base | None:
    if config.robust == "huber":
        return gtsam.noiseModel.mEstimator.Huber.Create(config.robust_scale)
    if config.robust == "cauchy":
        return gtsam.noiseModel.mEstimator.Cauchy.Create(config.robust_scale)
    return None
