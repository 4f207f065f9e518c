"""The chain of key poses in a factor graph, out of which poses are taken that add nothing to the map.

A graph with every key pose grows for ever, also where the robot has been often. What a pose adds is measured as in Ila,
Porta and Andrade-Cetto, IEEE Transactions on Robotics 26(1), 2010: by the information that its observations have on the
landmarks. A pose that is taken out leaves its motion to the next one. Its observations and links are lost: the estimate
is less certain, and stays consistent, because poses are chosen by covariances and not by what was measured.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmark_kernels import predictions, stacked
from sixthsense.core.landmarks import Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.se2 import between, compose
from sixthsense.slam.estimators.base import Link
from sixthsense.slam.estimators.isam2_factors import motion_factor

NONE = -1
"""number of a pose that there is not, and of a factor that the solver does not have yet"""
_WINDOW = 5  # of the newest poses that add nothing stay: the present pose is estimated with their observations, too


class _Step(NamedTuple):
    """How a pose follows another one in the graph."""

    before: int
    motion: Odometry
    factor: int
    """its number"""


class Joined(NamedTuple):
    """What replaces the motions to poses that were taken out, and on from them."""

    gone: list[int]
    """factors of these motions"""
    followers: list[int]
    """the poses that followed them"""
    factors: list[gtsam.NonlinearFactor]
    """of the motions to the followers, to be `renumbered`"""


class Chain:
    """Which poses are in the graph, the motions between them, and where the others lie."""

    def __init__(self) -> None:
        """Begin without a pose."""
        self._steps: dict[int, _Step] = {}
        self._spare: list[int] = []
        """poses that add nothing, the oldest first"""
        self._relative: dict[int, tuple[int, Odometry]] = {}
        """the pose that each pose which was taken out is fixed to, and where it is from there"""
        self._gone, self._motions = array("q"), array("d")
        """pairs of a pose that was taken out, ascending, and the one it is fixed to; x, y and theta from there"""

    def solved(self, motions: Mapping[int, tuple[Odometry, int]], factors: Sequence[int]) -> None:
        """Add solved poses, each with its motion from the pose before it, and the place of that one's factor."""
        for pose, (motion, at) in motions.items():
            self._steps[pose] = _Step(pose - 1, motion, factors[at])

    def spare(self, pose: int) -> None:
        """Take in that a pose adds nothing."""
        self._spare.append(pose)

    def due(self) -> list[int]:
        """The pose to take out next, if there is one."""
        return self._spare[:1] if len(self._spare) > _WINDOW else []

    def take_out(self, poses: Sequence[int], poses_at: Callable[[Sequence[int]], Array], with_wheels: bool) -> Joined:
        """Take solved poses out, ascending and after those of earlier calls, whose next ones are solved, too.

        `poses_at` is of the present solution.
        """
        gone: list[int] = []
        for pose in poses:
            step, after = self._steps[pose], self._steps[pose + 1]
            relative = between(*poses_at([step.before, pose]))
            del self._steps[pose]
            gone += [factor for factor in (step.factor, after.factor) if factor != NONE]
            self._steps[pose + 1] = _Step(step.before, step.motion.then(after.motion), NONE)
            # The pose has at most the uncertainty of the motion from its anchor.
            self._relative[pose] = step.before, Odometry(Pose(*relative.tolist()), step.motion.cov)
            self._gone.extend((pose, step.before))
            self._motions.extend(relative)
        out = set(poses)
        self._spare = [pose for pose in self._spare if pose not in out]
        followers = [pose + 1 for pose in poses if pose + 1 not in out]
        to_followers = [(self._steps[pose], X(pose)) for pose in followers]
        factors = [motion_factor(X(step.before), key, step.motion, with_wheels) for step, key in to_followers]
        return Joined(gone, followers, factors)

    def check_takeable(self, poses: Sequence[int]) -> None:
        """Raise KeyError for a pose that cannot be taken out."""
        least = self._gone[-2] if self._gone else 0
        for pose in poses:
            if pose <= least or pose not in self._steps or pose + 1 not in self._steps:
                raise KeyError(f"updates: found {pose}, allowed: ascending, after {least}, and before the last")
            least = pose

    def renumbered(self, poses: Sequence[int], factors: Sequence[int]) -> None:
        """Take in the numbers of the factors of the motions to some poses."""
        for pose, factor in zip(poses, factors, strict=True):
            self._steps[pose] = self._steps[pose]._replace(factor=factor)

    def anchored(self, pose: int) -> tuple[int, Odometry]:
        """The pose in the graph that a pose is fixed to, itself if it was not taken out, and where it is from there."""
        return self._relative.get(pose, (pose, STANDSTILL))

    def attached(self, links: Sequence[Link]) -> list[Link]:
        """Links between the poses in the graph that their poses are fixed to; those that they name stay."""
        if self._spare:
            named = {pose for link in links for pose in (link.before, link.after)}
            self._spare = [pose for pose in self._spare if pose not in named]
        if not self._relative:
            return list(links)
        found = []
        for link in links:
            (before, to_before), (after, to_after) = self.anchored(link.before), self.anchored(link.after)
            if before != link.before or after != link.after:
                back = to_after if to_after is STANDSTILL else to_after.inverse()
                link = Link(before, after, to_before.then(link.relative).then(back), link.loss_scale)
            found.append(link)
        return found

    def in_graph(self, poses: Sequence[int]) -> tuple[list[int], Array | None]:
        """The poses in the graph that some are fixed to, and (m, 3) where they are from there; None: at these."""
        if not any(pose in self._relative for pose in poses):
            return list(poses), None
        found = [self.anchored(pose) for pose in poses]
        return [anchor for anchor, _ in found], np.array([motion.motion.triple() for _, motion in found])

    def all_poses(self, kept: Array) -> Array:
        """(K, 3) all poses, of those (m, 3) that are in the graph."""
        if not self._gone:
            return kept
        (gone, anchors), relative = np.array(self._gone).reshape(-1, 2).T, np.array(self._motions).reshape(-1, 3)
        poses = np.empty((len(kept) + len(gone), 3))
        is_kept = np.ones(len(poses), dtype=np.bool_)
        is_kept[gone] = False
        poses[is_kept] = kept
        poses[gone] = compose(poses[anchors], relative)
        return poses


def map_gain(
    pose: Pose, joint: Array, landmarks: Array, walls: NDArray[np.bool_], observations: Sequence[Observation]
) -> float:
    """What observations of m known landmarks say of these in the mean, as mutual information in nats.

    `joint` (3 + 2m, 3 + 2m) is of the pose and the landmarks (m, 2) before the observations. What they say of pose and
    landmarks together is what they say of the landmarks, and of the pose once these are known.
    """
    _, by_pose, by_landmark = predictions(pose.triple(), landmarks, walls)
    H = stacked(by_pose, by_landmark, 3)
    noise = diagonal([observation.cov for observation in observations])
    if_known = joint[:3, :3] - joint[:3, 3:] @ np.linalg.solve(joint[3:, 3:], joint[3:, :3])
    of_all = np.linalg.slogdet(H @ joint @ H.T + noise)
    of_pose = np.linalg.slogdet(H[:, :3] @ if_known @ H[:, :3].T + noise)
    return 0.5 * float(of_all.logabsdet - of_pose.logabsdet) / len(observations)


def diagonal(blocks: Sequence[Array]) -> Array:
    """The matrix with these blocks (p, q) on its diagonal; scipy's asks for other array libraries at each block."""
    out = np.zeros((sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        height, width = block.shape
        out[row : row + height, column : column + width] = block
        row, column = row + height, column + width
    return out
