"""The factor graph that GTSAM's ISAM2 solves, with a table of its variables, and the chain of its key poses.

It solves with Cholesky factorization, and with QR once that fails numerically. Cholesky takes a third of the time,
since QR stacks all factors of walls that are seen from everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from enum import Enum
from typing import Any, Literal, NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.se2 import between, compose
from sixthsense.slam.estimators.base import Link
from sixthsense.slam.estimators.isam2_factors import to_pose2


class Kind(Enum):
    """What a variable of the graph is."""

    POSE = "x"
    WALL = "w"
    POINT = "l"


class Graph:
    """Factors, by the numbers that GTSAM gives them, and variables. New ones wait until it is solved."""

    def __init__(self, config: ISAM2Config) -> None:
        """Start empty."""
        self.isam = gtsam.ISAM2(solver_parameters(config))
        """for reading estimates"""
        self._config, self._by_qr = config, False
        self._factors, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._size = 0
        """number of factors so far, those that wait and those that are gone included"""
        self._table: dict[int, tuple[Kind, int]] = {}
        """kind of each key, and its update or landmark"""
        self.keys: dict[LandmarkId, int] = {}
        """of the landmarks, in the order of their first observation"""
        self._landmarks = 0
        """number of landmarks so far, forgotten ones included"""

    def add(self, factor: gtsam.NonlinearFactor) -> int:
        """Add a factor; its number."""
        self._factors.add(factor)
        self._size += 1
        return self._size - 1

    def insert(self, key: int, kind: Kind, i: int, value: Any) -> int:
        """Add a variable with its initial value, of an update or a landmark `i`; its key."""
        self._table[key] = kind, i
        self._values.insert(key, value)
        return key

    def insert_landmark(self, i: LandmarkId, kind: Kind, value: Any) -> int:
        """Add a landmark that is new; its key."""
        self._landmarks += 1
        self.keys[i] = self.insert(int(gtsam.symbol(kind.value, self._landmarks)), kind, i, value)
        return self.keys[i]

    def is_wall(self, i: LandmarkId) -> bool:
        """Whether a landmark is a wall."""
        return self._table[self.keys[i]][0] is Kind.WALL

    def guess(self, update: int, pose: Pose) -> None:
        """Change the initial value of a pose that waits."""
        self._values.update(X(update), to_pose2(pose))

    def solve(self, gone: Collection[int] = (), last: int | None = None) -> None:
        """Add what waits, remove the factors `gone`, and solve.

        The variable with the key `last` is eliminated last, so that its covariance costs little; by default those of
        the new factors are. Raises RuntimeError when QR finds no solution either.
        """
        groups = extra = None
        if last is not None:
            groups, extra = gtsam.KeyGroupMap(), gtsam.KeyList()
            groups.insert2(last, 1)
            extra.push_back(last)
        # New ones each time: a factor that is sent twice counts twice.
        factors, values = self._factors, self._values
        self._factors, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        try:
            self.isam.update(factors, values, sorted(gone), groups, None, extra)
        except RuntimeError:
            self._switch_to_qr()  # by now GTSAM has added the new factors to its graph and removed the old ones

    def settle(self, key: int, least: float, most: int, before: gtsam.Pose2 | None = None) -> None:
        """Solve again, at `most` so often, until the pose with this key moves by no more than `least`, m and rad.

        `before` is the pose before the last solution; None: that is unknown.
        """
        for _ in range(most):
            pose = self.isam.calculateEstimatePose2(key)
            if before is not None and np.abs(before.localCoordinates(pose)).max() <= least:
                return
            self.solve()
            before = pose

    def covariance(self, keys: Sequence[int]) -> Array:
        """Joint marginal covariance of variables in the order asked, each in its own tangent."""
        while True:
            try:
                if len(keys) == 1:
                    return np.ascontiguousarray(self.isam.marginalCovariance(keys[0]))
                return np.asarray(self.isam.jointMarginalCovariance(list(keys)).fullMatrix())
            except RuntimeError:
                self._switch_to_qr()  # which raises it where QR has failed, too

    def read(self) -> tuple[Array, Array]:
        """(m, 3) poses in the order of updates, and (n, 3) landmarks: the frames of walls, and x, y and 0 of points."""
        # GTSAM returns both in the order of their keys.
        values = self.isam.calculateEstimate()
        framed = np.asarray(gtsam.utilities.extractPose2(values)).reshape(-1, 3)
        if not self._landmarks:
            return framed, framed[:0]
        points = np.asarray(gtsam.utilities.extractPoint2(values)).reshape(-1, 2)
        kinds = [self._table[key] for key in values.keys()]  # noqa: SIM118
        is_pose = np.array([kind is Kind.POSE for kind, _ in kinds if kind in (Kind.POSE, Kind.WALL)], dtype=np.bool_)
        walls = [i for kind, i in kinds if kind is Kind.WALL]
        seen = [i for kind, i in kinds if kind is Kind.POINT]
        found = dict(zip(walls, framed[~is_pose], strict=True))
        found |= {i: np.append(point, 0.0) for i, point in zip(seen, points, strict=True)}
        return framed[is_pose], np.array([found[i] for i in self.keys]).reshape(-1, 3)

    def _switch_to_qr(self) -> None:
        """Move all factors to a solver that uses QR; they keep their numbers, since GTSAM keeps the empty places."""
        if self._by_qr:
            raise RuntimeError("the factor graph has no solution")
        self._by_qr = True
        factors, values = self.isam.getFactorsUnsafe(), gtsam.Values(self.isam.getLinearizationPoint())
        self.isam = gtsam.ISAM2(solver_parameters(self._config, "QR"))
        self.isam.update(factors, values)
        for _ in range(self._config.iterations):
            self.solve()


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


class Step(NamedTuple):
    """How a pose follows another one in the graph."""

    before: int
    motion: Odometry
    factor: int
    """its number"""


class Chain:
    """Which poses are in the graph, the motions between them, and where the others lie.

    A pose that is taken out leaves its motion to the next one. Its observations and links are lost: the estimate is
    less certain, and stays consistent, where poses are not chosen by what was measured.
    """

    def __init__(self) -> None:
        """Begin without a pose."""
        self.steps: dict[int, Step] = {}
        """to each pose in the graph but the first"""
        self._fixed: dict[int, tuple[int, Odometry]] = {}
        """the pose that each pose which was taken out is fixed to, and where it is from there"""

    def take_out(self, poses: Sequence[int], poses_at: Callable[[Sequence[int]], Array]) -> tuple[list[int], list[int]]:
        """Take solved poses out; the factors of motions that are gone, and the poses that need a new one.

        `poses_at` is of the present solution. Raises KeyError for a pose that cannot be taken out.
        """
        least = max(self._fixed, default=0)
        for pose in poses:
            if pose <= least or pose not in self.steps or pose + 1 not in self.steps:
                raise KeyError(f"updates: found {pose}, allowed: ascending, after {least}, and before the last")
            least = pose
        factors: list[int] = []
        for pose in poses:
            step, after = self.steps.pop(pose), self.steps[pose + 1]
            relative = between(*poses_at([step.before, pose]))
            factors += [step.factor, after.factor]
            self.steps[pose + 1] = Step(step.before, step.motion.then(after.motion), -1)
            # The pose has at most the uncertainty of the motion from its anchor.
            self._fixed[pose] = step.before, Odometry(Pose.from_array(relative), step.motion.cov)
        return [factor for factor in factors if factor >= 0], [pose + 1 for pose in poses if pose + 1 in self.steps]

    def anchored(self, pose: int) -> tuple[int, Odometry]:
        """The pose in the graph that a pose is fixed to, itself if it was not taken out, and where it is from there."""
        return self._fixed.get(pose, (pose, STANDSTILL))

    def attached(self, link: Link) -> Link:
        """The same link between the poses in the graph that its poses are fixed to."""
        (before, to_before), (after, to_after) = self.anchored(link.before), self.anchored(link.after)
        if (before, after) == (link.before, link.after):
            return link
        return Link(before, after, to_before.then(link.relative).then(to_after.inverse()), link.loss_scale)

    def all_poses(self, kept: Array) -> Array:
        """(K, 3) all poses, of those (m, 3) that are in the graph."""
        if not self._fixed:
            return kept
        gone, anchors = list(self._fixed), [anchor for anchor, _ in self._fixed.values()]
        relative = np.array([motion.motion.triple() for _, motion in self._fixed.values()])
        poses = np.empty((len(kept) + len(gone), 3))
        is_kept = np.ones(len(poses), dtype=np.bool_)
        is_kept[gone] = False
        poses[is_kept] = kept
        poses[gone] = compose(poses[anchors], relative)
        return poses
