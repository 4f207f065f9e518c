"""The interface of all estimators, and the contract they keep."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.tree import check_returned
from sixthsense.core.covariance import COVARIANCE_SLACK, check_covariance, covariance_fault
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.core.parameters import P, ParameterEstimate


@dataclass(frozen=True, slots=True)
class Estimate:
    """The present estimate; arrays are copies."""

    pose: Pose
    """`T_world_robot`"""
    pose_cov: Array
    """(3, 3) of (x, y, theta), world frame; m, rad"""
    ids: NDArray[np.int64]
    """(n,) of the landmarks, in the order of `landmarks`"""
    landmarks: Array
    """(n, 2) means, world frame: a point's x, y, m; a wall's alpha, d, rad and m"""
    walls: NDArray[np.bool_]
    """(n,) which of them are walls"""

    @classmethod
    def of_pose(cls, pose: Pose, pose_cov: Array) -> Estimate:
        """An estimate of which only the pose is known."""
        return cls(pose, pose_cov, np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0, dtype=np.bool_))


class Belief(Protocol):
    """Pose and landmarks with their joint covariance."""

    def estimate(self) -> Estimate:
        """The present pose with its covariance, and the landmarks' means."""

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose and the k landmarks, world frame, in the order asked; KeyError if unknown."""


class Estimator(Belief, Protocol):
    """Simultaneous localisation and mapping from odometry and observations with known association.

    1. `predict` never shrinks the joint covariance; many may precede an update.
    2. `update` takes each observation as independent. An unknown id, a forgotten one too, is a new landmark, augmented
       after all updates.
    3. An empty update leaves the covariance alone.
    4. `joint_covariance` is symmetric and positive semi-definite, begins with `pose_cov` and follows the order asked.
    5. Returned arrays are copies.
    6. The same calls give the same bits.
    7. An invalid covariance (not finite, not symmetric, indefinite; of an observation, not positive definite) raises a
       ValueError that names it and leaves the state unchanged. An odometry's and the start's may be zero.
    8. Walls may be refused: `update` then raises a NotImplementedError at a wall's first observation and leaves the
       state unchanged. All shipped estimators use walls.
    """

    def predict(self, odometry: Odometry) -> None:
        """Move by an increment in the robot's frame."""

    def update(self, observations: Mapping[LandmarkId, Observation]) -> None:
        """Update with the observations of one keyframe."""

    def forget(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks; KeyError for an unknown one."""

    def trajectory(self) -> Array:
        """(K, 3), the pose at each update so far, smoothed if the estimator smooths."""


@dataclass(frozen=True, slots=True)
class LandmarkPrior:
    """Landmarks of an earlier run, one joint Gaussian, independent of where the robot begins now."""

    ids: NDArray[np.int64]
    """(n,)"""
    landmarks: Array
    """(n, 2) means, world frame, as of `Estimate`"""
    walls: NDArray[np.bool_]
    """(n,) which of them are walls"""
    cov: Array
    """(2n, 2n) joint covariance, world frame, in the order of `ids`"""
    extents: Array
    """(n, 2, 2) ends of what was seen of a wall, world frame, m; unused for a point"""


@runtime_checkable
class Filter(Estimator, Protocol):
    """An estimator that begins with an earlier run's landmarks, and estimates the parameters of wheels and sensor.

    The shipped estimators are filters or smoothers. One of a user's needs no more than `Estimator` has; a configuration
    that asks for more says so.

    9. The landmarks of an earlier run keep their ids and count as known. Their joint covariance is used as evidence
       once. One that is forgotten leaves the marginal covariance of the others.
    10. Odometry's dependence on the wheels' parameters is used, with the prior and the parameters' correlation with
        pose and landmarks. Odometry that does not depend on them is used as without.
    11. All observations of points depend on the sensor's parameters, walls do not. The prior is used, and the
        parameters' correlation with pose and landmarks.
    12. What observations do not determine keeps its prior.
    """

    def start_from(self, prior: LandmarkPrior) -> None:
        """Begin with these landmarks.

        RuntimeError after the first motion or update. ValueError, with the state unchanged, for ids that repeat, means
        that are not finite and an invalid covariance, which may be singular.
        """

    def calibrate(self, prior: ParameterEstimate[Any]) -> None:
        """Estimate the parameters of the wheels, or of the sensor of points, from now on.

        RuntimeError after the first motion or update. ValueError for an invalid covariance.
        """

    def calibration(self, of: type[P]) -> ParameterEstimate[P] | None:
        """The present parameters, `Wheels` or `Sensor`, with their covariance; None if they are not estimated."""


@dataclass(frozen=True, slots=True)
class Link:
    """A measured motion between the poses of two updates."""

    before: int
    """index of the update whose pose the motion begins at, 0 for the first update"""
    after: int
    """index of the update whose pose it ends at"""
    relative: Odometry
    """the motion with its covariance"""
    loss_scale: float = math.inf
    """scale of the Cauchy loss, in whitened error; inf: squares"""


@runtime_checkable
class Smoother(Estimator, Protocol):
    """An estimator that keeps the poses of all updates and takes measurements between them.

    13. `link` takes each link as independent. Its pose need not be the newest.
    14. `unlink` leaves the estimate as if those links had not been given.
    15. `poses_at` returns rows of `trajectory`, and `relative_covariances` are of motions between them.
    16. The motion to a pose that is taken out, and on from it, become one. Its links are lost, and its row of
        `trajectory` stays, in a fixed place relative to a pose before it.
    """

    def link(self, links: Sequence[Link]) -> list[int]:
        """Update with links, and return their ids.

        Raises ValueError, naming the link, for an invalid covariance, and KeyError for an unknown pose; the state is
        unchanged then.
        """

    def unlink(self, ids: Collection[int]) -> None:
        """Remove links; KeyError, with the state unchanged, for an unknown id."""

    def poses_at(self, updates: Sequence[int]) -> Array:
        """(m, 3) the poses at some updates, by index; KeyError for an unknown one. A few cost less than all."""

    def relative_covariances(self, pairs: NDArray[np.int64]) -> Array:
        """(m, 3, 3) covariance of the pose at the second of two updates in the frame of that at the first, its axes.

        `pairs` (m, 2); KeyError for an unknown update.
        """

    def take_out(self, updates: Sequence[int]) -> list[int]:
        """Take out the poses of some updates, ascending and after those of earlier calls, and solve.

        Returns the ids of the links that are lost, which are unknown from then on. Raises KeyError, with the state
        unchanged, for another order, for the first pose and for the last one.
        """


def check_observations(observations: Mapping[LandmarkId, Observation]) -> None:
    """Raise ValueError, naming the landmark, for an observation that is not finite or whose covariance is invalid."""
    for i, seen in observations.items():
        if np.shape(seen.z) != (2,) or np.shape(seen.cov) != (2, 2):
            got = f"{np.shape(seen.z)} and {np.shape(seen.cov)}"
            raise ValueError(f"observation of landmark {i}: expected z (2,) and cov (2, 2), got {got}")
        if not (math.isfinite(seen.z[0]) and math.isfinite(seen.z[1])):
            raise ValueError(f"observation of landmark {i}: found z {seen.z}, allowed: finite numbers")
        (a, b), (c, d) = seen.cov.tolist()
        if not (abs(b - c) <= COVARIANCE_SLACK * max(a, d) and a > 0.0 and 0.0 < a * d - b * c < math.inf):
            fault = covariance_fault(seen.cov, lowest=0.0) or "a singular covariance"
            allowed = "a covariance, symmetric, with positive eigenvalues"
            raise ValueError(f"observation of landmark {i}: found {fault}, allowed: {allowed}")


def check_estimate(name: str, estimator: Estimator) -> None:
    """Raise PartError where what an estimator of this name returns has another shape, or is not finite."""
    part, found = f"estimator {name}", estimator.estimate()
    n = len(getattr(found, "ids", ()))
    check_returned(part, "estimate()", found, Estimate, pose_cov=(3, 3), landmarks=(n, 2))
    check_returned(part, "trajectory()", np.asarray(estimator.trajectory()), np.ndarray, itself=(None, 3))
    joint = np.asarray(estimator.joint_covariance(found.ids.tolist()))
    check_returned(part, "joint_covariance", joint, np.ndarray, itself=(3 + 2 * n, 3 + 2 * n))


def check_prior(prior: LandmarkPrior, has_begun: bool) -> None:
    """Raise RuntimeError if the estimator has begun, ValueError for an invalid prior."""
    if has_begun:
        raise RuntimeError("start_from: found a call after the first motion or update, allowed: before both")
    n = len(prior.ids)
    if len(np.unique(prior.ids)) != n:
        raise ValueError("prior: found ids that repeat, allowed: each landmark once")
    if prior.landmarks.shape != (n, 2) or not np.isfinite(prior.landmarks).all():
        raise ValueError(f"prior: found means {prior.landmarks.shape}, allowed: finite numbers, ({n}, 2)")
    fault = covariance_fault(prior.cov, lowest=-COVARIANCE_SLACK) if n else None
    if prior.cov.shape != (2 * n, 2 * n) or fault:
        raise ValueError(f"prior: found {fault or prior.cov.shape}, allowed: a covariance, ({2 * n}, {2 * n})")


def check_parameters(prior: ParameterEstimate[Any], has_begun: bool) -> None:
    """Raise RuntimeError if the estimator has begun, ValueError for an invalid covariance of the prior."""
    name = type(prior.values).__name__.lower()
    if has_begun:
        raise RuntimeError(f"calibrate {name}: found a call after the first motion or update, allowed: before both")
    n, fault = len(prior.values.array()), covariance_fault(prior.cov, lowest=-COVARIANCE_SLACK)
    if prior.cov.shape != (n, n) or fault:
        raise ValueError(f"prior of {name}: found {fault or prior.cov.shape}, allowed: a covariance, ({n}, {n})")


def check_links(links: Sequence[Link], poses: int) -> None:
    """Raise KeyError for a link to a pose that is not one of the `poses` so far, ValueError for an invalid one."""
    for k, link in enumerate(links):
        for pose in (link.before, link.after):
            if not 0 <= pose < poses:
                raise KeyError(f"link {k}: found pose {pose}, allowed: 0 to {poses - 1}")
        if link.before == link.after:
            raise ValueError(f"link {k}: found pose {link.after} at both ends, allowed: two poses")
        check_covariance(f"link {k}", link.relative.cov)
        if not np.isfinite(link.relative.motion.triple()).all():
            raise ValueError(f"link {k}: found {link.relative.motion}, allowed: finite numbers")
        if not link.loss_scale > 0.0:
            raise ValueError(f"link {k}: found loss_scale {link.loss_scale}, allowed: above 0")
