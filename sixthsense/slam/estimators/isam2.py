"""Incremental smoothing with GTSAM's ISAM2: all key poses and landmarks at once (Kaess et al., IJRR 31(2), 2012)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, W, X
from scipy.linalg import block_diag
from scipy.stats import chi2

from sixthsense.config import ISAM2Config
from sixthsense.core.covariance import check_covariance
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import LandmarkId, Sighting
from sixthsense.core.motion import STANDSTILL, Odometry, compose_jacobians
from sixthsense.slam.estimators.base import Estimate, check_sightings
from sixthsense.slam.estimators.evidence import Evidence
from sixthsense.slam.estimators.solver import Solver
from sixthsense.slam.estimators.wallframe import birth, lines, measurement

# Sigma (m, rad) that every pose's factor has at least: a certain motion or start must not make the system singular.
_FLOOR = 1e-6
_UNDO_PERIOD = 10  # updates between two looks for matches to take back
_MOST_UNDONE = 5  # at one look
_POINT = np.eye(2)  # a point's errors are those of GTSAM's tangent


class ISAM2:
    """A factor graph with one pose per update: a prior, odometry between poses, bearing and range to landmarks.

    A wall is a frame of its own (`wallframe.py`). GTSAM's tangent of a pose is the robot's frame: covariances are
    turned into it and out of it. Poses of updates without a sighting wait for the next update with one: until then
    there is nothing to solve.
    """

    def __init__(self, start: Pose, start_cov: Array, config: ISAM2Config) -> None:
        """Begin at `start` (world frame) known to `start_cov` (3, 3), which may be zero; ValueError if it is none."""
        self._start_cov = check_covariance("start_cov", start_cov)
        self._iterations, self._threshold = config.iterations, config.relinearize_threshold
        self._robust = _loss(config)
        self._evidence = Evidence()
        self._solver = Solver(config, self._evidence.renumber)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        """what the solver has not seen yet"""
        self._waiting: list[Pose] = []
        """poses among that, by odometry from the last one solved"""
        self._poses = 0
        """solved and waiting"""
        self._keys: dict[LandmarkId, int] = {}
        self._is_wall: dict[LandmarkId, bool] = {}
        self._born = 0
        self._undo_gate = float(chi2.ppf(config.undo_probability, 2))  # infinite for 1
        self.undone = 0
        """matches taken back so far"""
        self._step = STANDSTILL
        """motion since the last pose, waiting or not"""
        self._pending = STANDSTILL
        """motion since the last pose that was solved"""
        self._pose, self._pose_cov = start, self._start_cov
        """of the last pose that was solved"""
        self._landmarks = np.zeros((0, 2))
        self._by_tangent: dict[LandmarkId, Array] = {}
        """(2, 3) or (2, 2) errors of a landmark by those in GTSAM's tangent"""
        self._solved = np.zeros((0, 3))
        """all poses that were solved"""

    def predict(self, odometry: Odometry) -> None:
        """Move by an increment; it becomes part of the graph at the next update."""
        check_covariance("odometry", odometry.cov)
        if not odometry.is_standstill():
            self._step = self._step.then(odometry)
            self._pending = self._pending.then(odometry)

    def update(self, sightings: Mapping[LandmarkId, Sighting]) -> None:
        """Add the pose of now and what was sighted from it; solve if anything was."""
        check_sightings(sightings)
        guess = self._pose @ self._pending.motion
        self._add_pose(guess)
        self._waiting.append(guess)
        self._poses += 1
        self._step = STANDSTILL
        if not sightings:
            return
        first = self._graph.size()
        births = [i not in self._keys for i in sightings]
        for (i, sighting), is_new in zip(sightings.items(), births, strict=True):
            if is_new:
                self._bear(i, guess, sighting)
            add = self._wall_factor if sighting.is_wall else self._point_factor
            self._graph.add(add(self._keys[i], guess, sighting, is_new))
        places = self._solver.update(self._graph, self._values)
        for (i, sighting), place, is_new in zip(sightings.items(), places[first:], births, strict=True):
            self._evidence.add(self._poses - 1, i, place, sighting, is_new)
        # Fresh ones each time: a factor that is sent twice counts twice.
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._waiting.clear()
        self._pending = STANDSTILL
        self._settle(guess)
        self._read()
        if self._poses % _UNDO_PERIOD == 0:
            self._undo()

    def forget(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks with all their factors: what they have told of the poses is forgotten with them."""
        gone = set(ids)
        for i in gone:
            self._keys[i]  # KeyError before anything is removed
        if not gone:
            return
        places = self._evidence.places(gone)
        for i in gone:
            del self._keys[i], self._is_wall[i]
        self._remove(places)

    def estimate(self) -> Estimate:
        """The pose with all motion so far, its covariance, and the landmarks' means."""
        pose = self._pose @ self._pending.motion
        cov = self._moved(self._pose_cov)
        ids, walls = np.array(list(self._keys), dtype=np.int64), np.array(list(self._is_wall.values()), dtype=np.bool_)
        return Estimate(pose, cov, ids, self._landmarks.copy(), walls)

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose and the landmarks asked for, in that order."""
        keys = [self._keys[i] for i in ids]
        if not keys:
            return self._moved(self._pose_cov)
        # GTSAM answers in the order of the query, each variable in its own tangent.
        joint = self._solver.joint_covariance([self._last_solved, *keys])
        turn = np.eye(3)
        turn[:2, :2] = rotation(self._pose.theta)
        to_world = block_diag(turn, *(self._by_tangent[i] for i in ids))
        joint = to_world @ joint @ to_world.T
        joint[:3, :3] = self._pose_cov
        return self._moved(0.5 * (joint + joint.T))

    def trajectory(self) -> Array:
        """(K, 3), the pose at each update, as all evidence up to now has it."""
        return np.vstack([self._solved, *(pose.array() for pose in self._waiting)])

    def graph_error(self) -> float:
        """Half the sum of squared whitened residuals of all factors at the present estimate (GTSAM's convention)."""
        return float(self._solver.isam.getFactorsUnsafe().error(self._solver.isam.calculateEstimate()))

    @property
    def _last_solved(self) -> int:
        return int(X(self._poses - 1 - len(self._waiting)))

    def _add_pose(self, guess: Pose) -> None:
        key = X(self._poses)
        self._values.insert(key, _pose2(guess))
        if self._poses == 0:
            noise = _gaussian(Odometry(guess, self._moved(self._start_cov)))
            self._graph.add(gtsam.PriorFactorPose2(key, _pose2(guess), noise))
        else:
            noise = _gaussian(self._step)
            self._graph.add(gtsam.BetweenFactorPose2(key - 1, key, _pose2(self._step.motion), noise))

    def _bear(self, i: LandmarkId, guess: Pose, sighting: Sighting) -> None:
        self._is_wall[i] = sighting.is_wall
        if sighting.is_wall:
            self._keys[i] = W(self._born)
            self._values.insert(self._keys[i], _pose2(birth(guess, sighting)))
        else:
            self._keys[i] = L(self._born)
            bearing, distance, _ = sighting.bearing_range()
            self._values.insert(self._keys[i], guess @ (distance * rotation(bearing)[:, 0]))
        self._born += 1

    def _point_factor(self, key: int, guess: Pose, sighting: Sighting, is_new: bool) -> gtsam.NonlinearFactor:
        bearing, distance, cov = sighting.bearing_range()
        noise = self._robustly(gtsam.noiseModel.Gaussian.Covariance(cov))
        return gtsam.BearingRangeFactor2D(X(self._poses - 1), key, gtsam.Rot2(bearing), distance, noise)

    def _wall_factor(self, key: int, guess: Pose, sighting: Sighting, is_new: bool) -> gtsam.NonlinearFactor:
        frame = birth(guess, sighting) if is_new else _pose(self._solver.isam.calculateEstimatePose2(key))
        place, root = measurement(guess, frame, sighting, is_new)
        noise = self._robustly(gtsam.noiseModel.Gaussian.SqrtInformation(root))
        return gtsam.BetweenFactorPose2(key, X(self._poses - 1), _pose2(place), noise)

    def _robustly(self, noise: gtsam.noiseModel.Gaussian) -> gtsam.noiseModel.Base:
        return noise if self._robust is None else gtsam.noiseModel.Robust.Create(self._robust, noise)

    def _settle(self, guess: Pose) -> None:
        """Solve again while the newest pose lies farther than the threshold from where it was linearised."""
        linearised = _pose2(guess)
        for _ in range(self._iterations - 1):
            solved = self._solver.isam.calculateEstimatePose2(self._last_solved)
            if np.abs(linearised.localCoordinates(solved)).max() <= self._threshold:
                return
            self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values())
            linearised = solved

    def _remove(self, places: list[int]) -> None:
        """Take factors out of the graph and solve."""
        self._evidence.drop(places)
        self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), places)
        for _ in range(self._iterations - 1):
            self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values())
        self._read()

    def _undo(self) -> None:
        """Take back matches that all the other evidence contradicts, the worst first.

        At the solution a right sighting's residual is smaller than its noise has it, so the gate is on the safe side.
        Births stay: without its own a wall's frame could slide along the wall.
        """
        for _ in range(_MOST_UNDONE):
            ids = np.array(list(self._keys), dtype=np.int64)
            squared, places = self._evidence.squared_residuals(self.trajectory(), ids, self._landmarks)
            if not len(squared) or squared.max() <= self._undo_gate:
                return
            self._remove([int(places[squared.argmax()])])
            self.undone += 1

    def _read(self) -> None:
        """Take poses, the last one's covariance and landmarks over from the solver."""
        values = self._solver.isam.calculateEstimate()
        frames = np.asarray(gtsam.utilities.extractPose2(values)).reshape(-1, 3)
        points = np.asarray(gtsam.utilities.extractPoint2(values)).reshape(-1, 2)
        is_wall = np.array(list(self._is_wall.values()), dtype=np.bool_)
        # In the order of their keys: the letter of walls comes before that of poses, and both are numbered by birth.
        walls, self._solved = np.split(frames, [np.count_nonzero(is_wall)])
        means, axes = lines(walls)
        self._landmarks = np.empty((len(is_wall), 2))
        self._landmarks[is_wall], self._landmarks[~is_wall] = means, points
        of_walls = iter(axes)
        self._by_tangent = {i: next(of_walls) if wall else _POINT for i, wall in self._is_wall.items()}
        self._pose = Pose.from_array(self._solved[-1])
        turn = np.eye(3)
        turn[:2, :2] = rotation(self._pose.theta)
        cov = turn @ self._solver.covariance(self._last_solved) @ turn.T
        self._pose_cov = 0.5 * (cov + cov.T)

    def _moved(self, joint: Array) -> Array:
        """A joint covariance (n, n) of the last update's pose and landmarks, with the motion since taken in; a copy."""
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
    return gtsam.noiseModel.Gaussian.Covariance(motion.cov_after() + _FLOOR**2 * np.eye(3))


def _loss(config: ISAM2Config) -> gtsam.noiseModel.mEstimator.Base | None:
    if config.robust == "huber":
        return gtsam.noiseModel.mEstimator.Huber.Create(config.robust_scale)
    if config.robust == "cauchy":
        return gtsam.noiseModel.mEstimator.Cauchy.Create(config.robust_scale)
    return None
