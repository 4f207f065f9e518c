"""GTSAM's ISAM2, what waits for it, and what is read from it: the present pose, landmarks and their covariances.

It solves with Cholesky factorization, and with QR once that fails numerically. Estimates and covariances are read when
they are asked for: reading takes longer than most updates.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, cast

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry, compose_jacobians, propagated
from sixthsense.core.parameters import P, ParameterEstimate
from sixthsense.core.se2 import between, compose, move_covariance
from sixthsense.core.sensor import Sensor
from sixthsense.core.wheels import PARAMETERS, Wheels
from sixthsense.slam.estimators.base import check_parameters
from sixthsense.slam.estimators.isam2_chain import Chain, diagonal, map_gain
from sixthsense.slam.estimators.isam2_factors import (
    SENSOR,
    WHEELS,
    lines,
    parameters_factor,
    to_pose,
    to_pose2,
)


@dataclass(slots=True)
class Unsolved:
    """What the solver does not have yet."""

    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    motions: dict[int, tuple[Odometry, int]] = field(default_factory=dict)
    """to each of its poses from the one before, and the place of the factor in `graph`"""
    poses: list[Pose] = field(default_factory=list)
    """of updates since the last solved one, by odometry or by a link"""
    guessed: set[int] = field(default_factory=set)
    """which of them are by a link"""


_POINT = np.eye(2)  # a point's errors are those in GTSAM's tangent


class Kind(Enum):
    """What a variable of the graph is."""

    POSE = "x"
    WALL = "w"
    POINT = "l"


@dataclass(slots=True)
class Variables:
    """The variables of the graph but those of parameters, and landmarks in the order of the first observation."""

    table: dict[int, tuple[Kind, int]] = field(default_factory=dict)
    """kind of each key, and its update or landmark"""
    keys: dict[LandmarkId, int] = field(default_factory=dict)
    """of the landmarks"""
    means: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) of the landmarks at the last solution"""
    frames: dict[LandmarkId, Array] = field(default_factory=dict)
    """(3,) x, y and theta of the walls at the last solution"""
    by_tangent: dict[LandmarkId, Array] = field(default_factory=dict)
    """(2, 3) or (2, 2) Jacobian of a landmark by its variable's tangent in GTSAM"""
    made: int = 0
    """number of landmarks so far, forgotten ones included"""

    @property
    def ids(self) -> NDArray[np.int64]:
        """(n,) of the landmarks."""
        return np.array(list(self.keys), dtype=np.int64)

    @property
    def walls(self) -> NDArray[np.bool_]:
        """(n,) which landmarks are walls."""
        return np.array([self.table[key][0] is Kind.WALL for key in self.keys.values()], dtype=np.bool_)

    def add_pose(self, update: int) -> int:
        """Add the pose of an update; its key."""
        key = int(X(update))
        self.table[key] = Kind.POSE, update
        return key

    def add_landmark(self, i: LandmarkId, kind: Kind) -> int:
        """Add a landmark that is new; its key."""
        key = self.keys[i] = int(gtsam.symbol(kind.value, self.made))
        self.table[key] = kind, i
        self.made += 1
        return key

    def drop(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks."""
        is_kept = ~np.isin(self.ids, list(ids))
        if len(self.means) == len(self.keys):
            self.means = self.means[is_kept]
        for i in ids:
            del self.table[self.keys.pop(i)]

    def read(self, values: gtsam.Values) -> Array:
        """Read the landmarks from a solution; (m, 3) its poses in the order of their updates."""
        # GTSAM returns both in the order of their keys, and empty rows behind the points for vectors of another size.
        rows = np.asarray(gtsam.utilities.extractPose2(values)).reshape(-1, 3)
        points = np.asarray(gtsam.utilities.extractPoint2(values)).reshape(-1, 2)
        keys = values.keys()
        kinds = [self.table[key] for key in keys if key in self.table]
        framed = [each for each in kinds if each[0] is not Kind.POINT]
        is_pose = np.array([kind is Kind.POSE for kind, _ in framed], dtype=np.bool_)
        walls = [i for kind, i in framed if kind is Kind.WALL]
        of_walls, axes = lines(rows[~is_pose])
        self.frames = dict(zip(walls, rows[~is_pose], strict=True))
        seen = [i for kind, i in kinds if kind is Kind.POINT]
        self.by_tangent = dict(zip(walls, axes, strict=True)) | dict.fromkeys(seen, _POINT)
        found = dict(zip(walls, of_walls, strict=True)) | dict(zip(seen, points, strict=False))
        self.means = np.array([found[i] for i in self.keys]).reshape(-1, 2)
        return rows[is_pose]


class Solver:
    """Solves with Cholesky factorization until that fails, next to a certain start or among very different sigmas.

    From then on the same factors are in a solver that uses QR. Cholesky takes a third of the time, since QR stacks all
    factors of walls that are seen from everywhere. A factor keeps the number that it was given.
    """

    def __init__(self, config: ISAM2Config) -> None:
        """Start empty."""
        self.isam = gtsam.ISAM2(solver_parameters(config))
        """for reading estimates"""
        self._config, self._by_qr = config, False
        self._places: dict[int, int] = {}
        """in the graph of GTSAM's solver, of factors by number"""
        self._made = 0
        """number of factors so far"""

    def update(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, gone: Sequence[int] = (), last: int | None = None
    ) -> list[int]:
        """Add factors and values, remove the factors `gone`, and solve; the numbers of the new factors, ascending.

        The variable with the key `last` is eliminated last, so that its covariance costs little; by default those of
        the new factors are. Raises RuntimeError when QR finds no solution either.
        """
        groups = extra = None
        if last is not None:
            groups, extra = gtsam.KeyGroupMap(), gtsam.KeyList()
            groups.insert2(last, 1)
            extra.push_back(last)
        numbers = list(range(self._made, self._made + graph.size()))
        self._made += len(numbers)
        places = [self._places.pop(number) for number in gone]
        try:
            found = self.isam.update(graph, values, sorted(places), groups, None, extra).getNewFactorsIndices()
            self._places.update(zip(numbers, found, strict=True))
        except RuntimeError:
            # Before it fails the solver has added the new factors to its graph and removed the old ones.
            size = self.isam.getFactorsUnsafe().size()
            self._places.update(zip(numbers, range(size - len(numbers), size), strict=True))
            self._switch_to_qr()
        return numbers

    def iterate(self, count: int = 1) -> None:
        """Solve again from the present solution."""
        for _ in range(count):
            self.update(gtsam.NonlinearFactorGraph(), gtsam.Values())

    def converge(self, key: int, least: float, most: int) -> None:
        """Iterate at most so many times, until the pose with this key moves by no more than `least`, m and rad."""
        pose = self.isam.calculateEstimatePose2(key)
        for _ in range(most):
            self.iterate()
            before, pose = pose, self.isam.calculateEstimatePose2(key)
            if np.abs(before.localCoordinates(pose)).max() <= least:
                return

    def relinearize(self, key: int, guess: Pose) -> None:
        """Iterate while the pose with this key, linearized at `guess`, is farther than the threshold from there."""
        linearized = to_pose2(guess)
        for _ in range(self._config.iterations - 1):
            solved = self.isam.calculateEstimatePose2(key)
            if np.abs(linearized.localCoordinates(solved)).max() <= self._config.relinearize_threshold:
                return
            self.iterate()
            linearized = solved

    def covariance(self, keys: Sequence[int]) -> Array:
        """Joint marginal covariance of variables in the order asked, each in its own tangent."""
        while True:
            try:
                if len(keys) == 1:
                    return np.ascontiguousarray(self.isam.marginalCovariance(keys[0]))
                return np.asarray(self.isam.jointMarginalCovariance(list(keys)).fullMatrix())
            except RuntimeError:
                self._switch_to_qr()  # which raises it where QR has failed, too

    def _switch_to_qr(self) -> None:
        """Move all factors to a solver that uses QR."""
        if self._by_qr:
            raise RuntimeError("the factor graph has no solution")
        self._by_qr = True
        factors, values = self.isam.getFactorsUnsafe(), gtsam.Values(self.isam.getLinearizationPoint())
        graph = gtsam.NonlinearFactorGraph()
        for place in self._places.values():
            graph.add(factors.at(place))
        self.isam = gtsam.ISAM2(solver_parameters(self._config, "QR"))
        self.isam.update(graph, values)
        self._places = {number: place for place, number in enumerate(self._places)}
        for _ in range(self._config.iterations):
            self.isam.update()


def solver_parameters(config: ISAM2Config, factorization: Literal["CHOLESKY", "QR"] = "CHOLESKY") -> gtsam.ISAM2Params:
    """GTSAM's parameters for a configuration."""
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(config.relinearize_threshold)
    parameters.relinearizeSkip = 1  # each update checks: what has moved is linearized anew at once
    parameters.setFactorization(factorization)
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.05 * config.relinearize_threshold))
    parameters.enableAdaptiveReorder = True  # a stale order costs 50 % more at the 99th percentile
    parameters.enablePartialRelinearizationCheck = True  # only below poses that have moved
    return parameters


class Solution:
    """The last solution: the present pose and parameters with their joint covariance, all poses, and landmarks."""

    def __init__(self, solver: Solver, variables: Variables, chain: Chain, start: tuple[Pose, Array]) -> None:
        """Begin without a solution at a pose, `T_world_robot`, with its covariance (3, 3)."""
        self._solver, self._variables, self._chain = solver, variables, chain
        self.pose, self._cov = start
        """of the last solved pose, or the start; the covariance has the wheels' parameters, too, if there are any"""
        self.wheels: Wheels | None = None
        """at the last solution, if they are estimated"""
        self.sensor: Sensor | None = None
        """at the last solution, if its parameters are estimated"""
        self._sensor_prior: ParameterEstimate[Sensor] | None = None
        self.keys: list[int] = []
        """of the last solved pose, and the wheels; empty until there is a solution"""
        self._has_cov = True
        """whether the covariance is that of the last solution"""
        self._poses: Array | None = np.zeros((0, 3))
        """all poses, once they were asked for"""
        self._in_graph = np.zeros((0, 3))
        self._has_read = True
        """whether poses and landmarks are those of the last solution"""
        self._joint, self._pending = np.zeros((3, 3)), STANDSTILL
        """the last joint covariance that was asked for, and the motion since the solution then"""
        self._rows: dict[LandmarkId, int] = {}
        """of the landmarks in it; none of an earlier solution"""

    def add(self, prior: ParameterEstimate[Any], unsolved: Unsolved, has_begun: bool) -> None:
        """Add parameters; RuntimeError if the estimator has begun or has them."""
        check_parameters(prior, has_begun or self.parameters(type(prior.values)) is not None)
        key = WHEELS if isinstance(prior.values, Wheels) else SENSOR
        unsolved.values.insert(key, prior.values.array())
        unsolved.graph.add(parameters_factor(key, prior))
        if isinstance(prior.values, Wheels):
            self.wheels, self._cov = prior.values, diagonal([self._cov, prior.cov])
        else:
            self.sensor, self._sensor_prior = prior.values, prior

    def parameters(self, of: type[P]) -> ParameterEstimate[P] | None:
        """The parameters of this kind, if they are estimated."""
        found: Any = self._sensor_prior
        if of is Wheels:
            found = None if self.wheels is None else ParameterEstimate(self.wheels, self.cov()[3:, 3:].copy())
        elif self.sensor is not None and self.keys:
            found = ParameterEstimate(self.sensor, self._solver.covariance([SENSOR]))
        return cast("ParameterEstimate[P] | None", found)

    def update(self, last: int) -> None:
        """Take in that there is a new solution, whose last pose has this key."""
        self._has_read, self._has_cov, self._poses, self._rows = False, False, None, {}
        self.keys = [last] if self.wheels is None else [last, WHEELS]
        self.pose = to_pose(self._solver.isam.calculateEstimatePose2(last))
        if self.wheels is not None:
            self.wheels = Wheels.from_array(self._solver.isam.calculateEstimateVector(WHEELS))
        if self.sensor is not None:
            self.sensor = Sensor.from_array(self._solver.isam.calculateEstimateVector(SENSOR))

    def cov(self) -> Array:
        """(3, 3) of the pose, or (8, 8) with the wheels' parameters, world frame."""
        if not self._has_cov:
            self._cov, self._has_cov = self._solver.covariance(self.keys), True
            if self.wheels is None:
                self._cov = move_covariance((0.0, 0.0, self.pose.theta), self._cov)
            else:
                to_world = self.to_world()
                cov = to_world @ self._cov @ to_world.T
                self._cov = 0.5 * (cov + cov.T)
        return self._cov

    def to_world(self) -> Array:
        """From GTSAM's tangents of these variables to the axes of `cov`."""
        turn = Pose(theta=self.pose.theta).adjoint()
        return turn if self.wheels is None else diagonal([turn, np.eye(PARAMETERS)])

    def after(self, pending: Odometry) -> Pose:
        """The pose after a motion, for the present parameters of the wheels."""
        motion = pending if self.wheels is None else pending.with_wheels(self.wheels)
        return self.pose @ motion.motion

    def propagated(self, joint: Array, pending: Odometry) -> Array:
        """Joint covariance (3 + 2k, 3 + 2k) of the pose after the motion `pending`, and of k landmarks; a copy.

        `joint` (n + 2k, n + 2k) is that of the n values that `cov` is of, and the landmarks.
        """
        if len(joint) == 3 and pending is STANDSTILL:
            return joint.copy()
        if len(joint) == 3:
            moved = propagated(self.pose, joint, pending)
            return np.asarray(0.5 * (moved + moved.T))
        n = len(self._cov)
        kept = np.concatenate([np.arange(3), np.arange(n, len(joint))])
        if pending is STANDSTILL:
            return np.asarray(joint[np.ix_(kept, kept)])
        motion = pending if self.wheels is None else pending.with_wheels(self.wheels)
        by_pose, by_motion = compose_jacobians(self.pose.theta, motion.motion)
        by_head = np.zeros((3, n))
        by_head[:, :3] = by_pose
        if self.wheels is not None and motion.wheels is not None:
            by_head[:, 3:] = by_motion @ motion.wheels.jacobian
        moved = joint.copy()
        moved[:3] = by_head @ moved[:n]
        moved[:, :3] = moved[:, :n] @ by_head.T
        moved[:3, :3] += by_motion @ motion.cov @ by_motion.T
        moved = moved[np.ix_(kept, kept)]
        return np.asarray(0.5 * (moved + moved.T))

    def poses_at(self, updates: Sequence[int]) -> Array:
        """(m, 3) the poses of updates that are solved."""
        if self._poses is not None:
            return self._poses[list(updates)]
        anchors, motions = self._chain.in_graph(updates)
        found = [self._solver.isam.calculateEstimatePose2(X(k)) for k in anchors]
        poses = np.array([(pose.x(), pose.y(), pose.theta()) for pose in found]).reshape(-1, 3)
        return poses if motions is None else compose(poses, motions)

    def relative(self, before: int, after: int) -> Odometry:
        """A solved pose in the frame of another one, with what their errors have in common."""
        (first, to_first), (second, to_second) = self._chain.anchored(before), self._chain.anchored(after)
        motion, cov = Pose(), np.zeros((3, 3))
        if first != second:
            joint = self._solver.covariance([X(first), X(second)])
            motion = Pose(*between(*self.poses_at([first, second])))
            by_poses = np.hstack([-motion.inverse().adjoint(), np.eye(3)])  # each pose errs in its own axes
            cov = by_poses @ joint @ by_poses.T
        return to_first.inverse().then(Odometry(motion, 0.5 * (cov + cov.T))).then(to_second)

    def poses(self) -> Array:
        """(K, 3) all solved poses."""
        self._read()
        if self._poses is None:
            self._poses = self._chain.all_poses(self._in_graph)
        return self._poses

    def landmarks(self) -> Variables:
        """The landmarks with their present means."""
        if self._variables.keys or len(self._variables.means):
            self._read()
        return self._variables

    def joint_covariance(self, ids: Sequence[LandmarkId], pending: Odometry) -> Array:
        """(3 + 2k, 3 + 2k) of the pose after a motion since the solution and of the landmarks; KeyError for others."""
        landmarks, cov = self.landmarks(), self.cov()
        keys = [landmarks.keys[i] for i in ids]
        if not keys:
            return self.propagated(cov, pending)
        # GTSAM answers in the order of the query, each variable in its own tangent.
        of_head = [self.to_world()] if self.keys else []
        to_axes = diagonal([*of_head, *(landmarks.by_tangent[i] for i in ids)])
        joint = to_axes @ self._solver.covariance([*self.keys, *keys]) @ to_axes.T
        if not of_head:  # landmarks of an earlier run, and the start
            joint = diagonal([cov, joint])
        joint[: len(cov), : len(cov)] = cov
        joint = self.propagated(0.5 * (joint + joint.T), pending)
        self._joint, self._pending = joint.copy(), pending
        self._rows = {i: 3 + 2 * k for k, i in enumerate(ids)}
        return joint

    def map_gain(self, pose: Pose, observations: Mapping[LandmarkId, Observation], pending: Odometry) -> float:
        """What observations of known landmarks from the pose after a motion say of these in the mean, nats."""
        if self._pending is not pending or not self._rows.keys() >= observations.keys():
            self.joint_covariance(list(observations), pending)  # else who matched them has asked for it
        asked = np.concatenate([np.arange(3), *(self._rows[i] + np.arange(2) for i in observations)])
        landmarks, joint = self.landmarks(), self._joint[np.ix_(asked, asked)]
        row = {i: k for k, i in enumerate(landmarks.keys)}
        rows = [row[i] for i in observations]
        return map_gain(pose, joint, landmarks.means[rows], landmarks.walls[rows], list(observations.values()))

    def _read(self) -> None:
        """Read poses and landmarks from the solver, if they are not those of the last solution."""
        if self._has_read:
            return
        self._in_graph = self._variables.read(self._solver.isam.calculateEstimate())
        self._has_read = True
