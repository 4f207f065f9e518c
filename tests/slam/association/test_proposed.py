"""Landmarks where a proposed pose places them."""

from dataclasses import replace

import numpy as np
import pytest

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, Observation, initialize_landmark
from sixthsense.slam.association.proposed import ProposedLandmarks
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators.base import Estimate

OBSERVATIONS = {
    3: Observation(Kind.CORNER, np.array([2.0, -1.0]), np.diag([1e-4, 4e-4])),
    7: Observation(Kind.WALL, np.array([0.4, 3.0]), np.array([[1e-5, 1e-6], [1e-6, 1e-4]]), (-1.0, 2.0)),
}
HERE = Pose(5.0, -2.0, 0.7)


def known(pose: Pose) -> Estimate:
    landmarks = np.array([initialize_landmark(pose, observation)[0] for observation in OBSERVATIONS.values()])
    walls = np.array([observation.is_wall for observation in OBSERVATIONS.values()])
    return Estimate(pose, np.zeros((3, 3)), np.array(list(OBSERVATIONS)), landmarks, walls)


def records() -> dict[int, Record]:
    return {i: Record(s.kind, 1, 0, 0, extent=np.array([[1.0, 2.0], [3.0, 4.0]])) for i, s in OBSERVATIONS.items()}


def proposal(relative: Pose, *sigmas: float) -> tuple[Array, Array]:
    return relative.array()[None], np.array([sigmas or (0.0, 0.0, 0.0)])


@pytest.mark.parametrize("turn", [0.0, 0.5, 3.0])
def test_landmarks_are_where_they_would_be_observed_again(turn: float) -> None:
    proposed, kept = ProposedLandmarks(), records()
    proposed.remember(0, known(HERE), OBSERVATIONS, kept)
    step = Pose(0.5, 0.2, turn)
    # The estimate has moved since, and is not asked.
    proposed.place(*proposal(step.inverse()), known(Pose(-9.0, 4.0, 2.0)))
    there = proposed.estimate()
    assert there.pose == Pose() and there.ids.tolist() == [3, 7] and there.walls.tolist() == [False, True]
    expected = [initialize_landmark(step.inverse(), observation)[0] for observation in OBSERVATIONS.values()]
    assert np.allclose(there.landmarks, expected, atol=1e-12)


def test_the_covariance_is_that_of_the_observation_and_of_the_pose_it_was_made_from() -> None:
    rng = np.random.default_rng(1)
    step, sigma = Pose(1.5, -0.7, 0.8), 1e-3
    proposed, kept = ProposedLandmarks(), records()
    proposed.remember(0, known(HERE), OBSERVATIONS, kept)
    relative = np.array([step.array()])
    proposed.place(relative, sigma * np.array([[1.0, 1.0, 2.0]]), known(HERE))
    joint = proposed.joint_covariance([7, 3])
    assert np.array_equal(joint, joint.T) and joint.shape == (7, 7)
    for i, block in ((7, joint[3:5, 3:5]), (3, joint[5:, 5:])):
        pose = step.array() + rng.standard_normal((6_000, 3)) * [sigma, sigma, 2 * sigma]
        z = rng.multivariate_normal(OBSERVATIONS[i].z, OBSERVATIONS[i].cov, size=len(pose))
        drawn = np.array(
            [
                initialize_landmark(Pose(*row), replace(OBSERVATIONS[i], z=seen))[0]
                for row, seen in zip(pose.tolist(), z, strict=True)
            ]
        )
        assert np.allclose(np.cov(drawn.T), block, rtol=0.12, atol=2e-6)


@pytest.mark.parametrize(
    ("sigmas", "count"),
    [((0.3, 0.3, 0.15), 2), ((0.4, 0.1, 0.1), 0), ((0.1, 0.4, 0.1), 0), ((0.1, 0.1, 0.25), 0)],
)
def test_a_landmark_of_an_uncertain_keyframe_is_not_placed(sigmas: tuple[float, float, float], count: int) -> None:
    proposed, kept = ProposedLandmarks(), records()
    proposed.remember(0, known(HERE), OBSERVATIONS, kept)
    proposed.place(*proposal(Pose(), *sigmas), known(HERE))
    assert len(proposed.estimate().ids) == count
