"""What an observation truly is of, in scenes in which it can be of two walls.

An observation here is an ideal one unless it is extracted from a simulated scan.
"""

import numpy as np
import pytest
from predicted import ideal_wall, predict_points

from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.evaluation.true_identities import identify, landmark_identities, true_identities

MOUNT = (0.35, -0.2, 0.7)
COV = np.diag([0.01**2, 0.005**2])

# Two rooms side by side, 0.2 m of solid between them; a wall that stands free, thin; a wall in two pieces in line.
WALLS = np.array([
    [[0.0, 0.0], [4.0, 0.0]], [[6.0, 0.0], [9.0, 0.0]], [[4.0, 0.0], [4.0, 3.0]], [[4.2, 0.0], [4.2, 3.0]],
    [[1.0, 1.5], [2.0, 1.5]],
])  # fmt: skip
SCENE = true_identities(WALLS)
BELOW, ABOVE = Pose(1.5, 0.8, 0.4), Pose(1.5, 2.2, -0.3)


def wall(pose, first, last, cov=COV):
    """An observation of a wall from one place in the world to another."""
    return ideal_wall(pose, np.array([first, last], dtype=float), cov)


def end(pose, position, cov=COV):
    """An observation of a free end at a position in the world."""
    return Observation(Kind.END, predict_points(pose, np.array([position], dtype=float))[0][0], cov)


def faces(observation, pose, scene=SCENE):
    """Of which faces or point it is, the one with most returns first."""
    return identify([observation], pose, scene)[0]


def test_the_sides_of_a_thin_wall_are_two_identities():
    (below,) = faces(wall(BELOW, [1.0, 1.5], [2.0, 1.5]), BELOW)
    (above,) = faces(wall(ABOVE, [1.0, 1.5], [2.0, 1.5]), ABOVE)
    assert below != above and below[1] == above[1]


def test_the_identity_of_a_point_is_the_end_of_the_wall_that_is_seen_beside_it():
    left, right = (faces(end(BELOW, p), BELOW) for p in ((1.0, 1.5), (2.0, 1.5)))
    assert len(left) == len(right) == 1 and left != right
    assert faces(end(BELOW, (2.03, 1.5)), BELOW) == right
    assert faces(end(BELOW, (2.15, 1.65)), BELOW) == []


def test_a_landmark_is_what_most_of_its_observations_are_of_and_nothing_if_most_are_of_several_walls():
    step = np.array([[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.05], [4.0, 0.05]]])
    scene, pose = true_identities(step), Pose(2.0, 1.5, -1.0)
    first, second = wall(pose, [0.2, 0.0], [1.9, 0.0]), wall(pose, [2.1, 0.05], [3.8, 0.05])
    both = wall(pose, [0.2, 0.0], [3.8, 0.05])
    scans = [{3: first, 4: first, 5: first}, {3: second, 4: both, 5: second}, {3: second, 4: both}]
    found = landmark_identities(scans, np.array([pose.array()] * 3), scene)
    assert [found] == [{3: face} for face in faces(second, pose, scene)]


@pytest.mark.parametrize(("last_x", "expected"), [(2.35, 1), (2.9, 2)])
def test_a_second_wall_counts_from_a_tenth_of_the_observed_one_on(last_x, expected):
    """A wall with a step of 0.06 m."""
    step = np.array([[[0.3, 0.2], [2.3, 0.2]], [[2.3, 0.14], [4.3, 0.14]]])
    pose = Pose(2.4, 2.1, -1.1)
    assert len(faces(wall(pose, [0.5, 0.2], [last_x, 0.2]), pose, true_identities(step))) == expected


def test_what_is_seen_through_a_gap_in_a_wall_is_no_part_of_it():
    gap = np.array([[[0.3, 0.2], [1.3, 0.2]], [[2.3, 0.2], [4.3, 0.2]], [[0.0, -1.5], [4.0, -1.5]]])
    pose, scene = Pose(2.4, 2.1, -1.1), true_identities(gap)
    assert faces(wall(pose, [0.4, 0.2], [4.0, 0.2]), pose, scene) == [("front", int(scene.line_of[0]))]
