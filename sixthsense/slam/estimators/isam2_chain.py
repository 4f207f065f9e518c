"""The chain of key poses in a factor graph, out of which poses are taken that add nothing to the map.

A graph with every key pose grows for ever, also where the robot has been often. What a pose adds is measured as in Ila,
Porta and Andrade-Cetto, IEEE Transactions on Robotics 26(1), 2010: by the information that its sightings have on the
landmarks. A pose that is taken out leaves its motion to the next one. Its sightings are lost: the estimate is less
certain, and stays consistent, because poses are chosen by covariances and not by what was measured.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy.linalg import block_diag

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Sighting, predict, stacked_jacobian
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.slam.estimators.base import Link
from sixthsense.slam.estimators.isam2_wheels import motion_factor

_WINDOW = 5  # of the newest poses that add nothing stay: the present pose is estimated with their sightings, too


class _Step(NamedTuple):
    """How a pose follows another one in the graph."""

    before: int
    motion: Odometry
    place: int
    """of its factor"""


class Chain:
    """Which poses are in the graph, the motions between them, and where the others lie."""

    def __init__(self) -> None:
        """Begin without a pose."""
        self._steps: dict[int, _Step] = {}
        self._spare: list[int] = []
        """poses that add nothing, the oldest first"""
        self._anchors: list[int] = []
        """the pose that each pose which was taken out is fixed to, in order of `_gone`"""
        self._gone: list[int] = []
        self._relative: list[Odometry] = []
        """from the anchor, with at most the uncertainty of the motion between"""

    def add(self, pose: int, motion: Odometry, place: int) -> None:
        """Add a solved pose, whose motion from the pose before it has its factor at that place."""
        self._steps[pose] = _Step(pose - 1, motion, place)

    def spare(self, pose: int) -> None:
        """Take in that a pose adds nothing."""
        self._spare.append(pose)

    def keep(self, poses: Collection[int]) -> None:
        """Take in that these poses stay."""
        self._spare = [pose for pose in self._spare if pose not in poses]

    def due(self) -> int | None:
        """The pose to take out next, if there is one."""
        return self._spare[0] if len(self._spare) > _WINDOW else None

    def take_out(self, pose: int, pose_at: Callable[[int], Pose]) -> tuple[list[int], gtsam.NonlinearFactor]:
        """Take a solved pose out, whose next one is solved, too; `pose_at` is of the present solution.

        Returns the places of the motions to it and on from it, and the factor of both together, to be `placed`.
        """
        step, after = self._steps[pose], self._steps[pose + 1]
        relative = pose_at(step.before).inverse() @ pose_at(pose)
        del self._steps[pose]
        self._steps[pose + 1] = _Step(step.before, step.motion.then(after.motion), -1)
        self._spare.remove(pose)
        self._gone.append(pose)
        self._anchors.append(step.before)
        self._relative.append(Odometry(relative, step.motion.cov))
        motion = self._steps[pose + 1].motion
        return [step.place, after.place], motion_factor(X(step.before), X(pose + 1), motion, with_wheels=False)

    def placed(self, pose: int, place: int) -> None:
        """Take in the place of the factor of the motion to a pose."""
        self._steps[pose] = self._steps[pose]._replace(place=place)

    def anchored(self, pose: int) -> tuple[int, Odometry]:
        """The pose in the graph that a pose is fixed to, itself if it was not taken out, and where it is from there."""
        k = int(np.searchsorted(self._gone, pose))
        if k == len(self._gone) or self._gone[k] != pose:
            return pose, STANDSTILL
        return self._anchors[k], self._relative[k]

    def attached(self, link: Link) -> Link:
        """A link between the poses in the graph that its poses are fixed to."""
        (before, to_before), (after, to_after) = self.anchored(link.before), self.anchored(link.after)
        if before == link.before and after == link.after:
            return link
        back = to_after if to_after is STANDSTILL else to_after.inverse()
        return Link(before, after, to_before.then(link.relative).then(back), link.loss_scale)

    def renumber(self, before: Sequence[int], after: Sequence[int]) -> None:
        """Renumber the factors: those at the places `before` are now at `after`."""
        moved = dict(zip(before, after, strict=True))
        self._steps = {k: step._replace(place=moved.get(step.place, -1)) for k, step in self._steps.items()}

    def all_poses(self, kept: Array) -> Array:
        """(K, 3) all poses, of those (m, 3) that are in the graph."""
        if not self._gone:
            return kept
        poses = np.empty((len(kept) + len(self._gone), 3))
        is_kept = np.ones(len(poses), dtype=np.bool_)
        is_kept[self._gone] = False
        poses[is_kept] = kept
        at, relative = poses[self._anchors], np.array([relative.motion.array() for relative in self._relative])
        c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
        poses[self._gone] = np.column_stack([
            at[:, 0] + c * relative[:, 0] - s * relative[:, 1],
            at[:, 1] + s * relative[:, 0] + c * relative[:, 1],
            wrap_angle(at[:, 2] + relative[:, 2]),
        ])  # fmt: skip
        return poses


def map_gain(
    pose: Pose, joint: Array, landmarks: Array, walls: NDArray[np.bool_], sightings: Sequence[Sighting]
) -> float:
    """What sightings of m known landmarks say of these in the mean, as mutual information in nats.

    `joint` (3 + 2m, 3 + 2m) is of the pose and the landmarks (m, 2) before the sightings. What they say of pose and
    landmarks together is what they say of the landmarks, and of the pose once these are known.
    """
    _, by_pose, by_landmark = predict(pose, landmarks, walls)
    H = stacked_jacobian(by_pose, by_landmark)
    noise = block_diag(*(sighting.cov for sighting in sightings))
    if_known = joint[:3, :3] - joint[:3, 3:] @ np.linalg.solve(joint[3:, 3:], joint[3:, :3])
    of_all = np.linalg.slogdet(H @ joint @ H.T + noise)
    of_pose = np.linalg.slogdet(H[:, :3] @ if_known @ H[:, :3].T + noise)
    return 0.5 * float(of_all.logabsdet - of_pose.logabsdet) / len(sightings)
