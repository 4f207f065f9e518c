import numpy as np
import pytest

from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Sighting, predict_points, predict_walls
from sixthsense.evaluation.matches import explained_by, judge_matches, true_identities

# Two rooms side by side, 0.2 m of solid between them; a wall that stands free, thin; a wall in two pieces in line.
WALLS = np.array(
    [
        [[0.0, 0.0], [4.0, 0.0]],
        [[6.0, 0.0], [9.0, 0.0]],
        [[4.0, 0.0], [4.0, 3.0]],
        [[4.2, 0.0], [4.2, 3.0]],
        [[1.0, 1.5], [2.0, 1.5]],
    ]
)
SCENE = true_identities(WALLS)
COV = np.diag([0.01**2, 0.005**2])


def wall(pose, alpha, d, extent=(-0.5, 0.5), cov=COV):
    """The exact sighting of the line (alpha, d), the normal towards the robot, from a pose."""
    z = predict_walls(pose, np.array([[alpha, d]]))[0][0]
    return Sighting(Kind.WALL, z, cov, extent)


def point(pose, position, cov=COV):
    return Sighting(Kind.END, predict_points(pose, np.array([position]))[0][0], cov)


BELOW, ABOVE = Pose(1.5, 0.8, 0.4), Pose(1.5, 2.2, -0.3)


def test_collinear_walls_share_a_line_and_parallel_ones_do_not():
    assert len(SCENE.lines) == 4
    assert SCENE.line_of[0] == SCENE.line_of[1]
    assert SCENE.line_of[2] != SCENE.line_of[3]


def test_a_line_does_not_depend_on_the_direction_of_its_wall():
    again = true_identities(WALLS[::-1, ::-1])
    assert len(again.lines) == 4


def test_the_sides_of_a_thin_wall_are_two_identities():
    from_below = explained_by(wall(BELOW, -np.pi / 2, -1.5), BELOW, SCENE)
    from_above = explained_by(wall(ABOVE, np.pi / 2, 1.5), ABOVE, SCENE)
    assert len(from_below) == len(from_above) == 1
    assert from_below.isdisjoint(from_above)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_faces_of_a_thick_wall_are_distinguished(side):
    pose = Pose(4.1 + side, 1.5, 0.2)
    near = explained_by(wall(pose, 0.0 if side > 0 else np.pi, (4.1 + 0.1 * side) * side), pose, SCENE)
    far = explained_by(wall(pose, 0.0 if side > 0 else np.pi, (4.1 - 0.1 * side) * side), pose, SCENE)
    assert len(near) == len(far) == 1
    assert near.isdisjoint(far)


def test_a_line_explains_a_sighting_only_where_it_has_a_wall():
    pose = Pose(5.0, 1.0, 0.0)
    # The extent of a wall whose normal points up runs along -x.
    in_the_gap = wall(pose, np.pi / 2, 0.0, extent=(-0.4, 0.4))
    assert not explained_by(in_the_gap, pose, SCENE)
    assert explained_by(wall(pose, np.pi / 2, 0.0, extent=(-2.0, -1.5)), pose, SCENE)


def test_a_sighting_beyond_its_covariance_is_unexplained():
    off = wall(BELOW, -np.pi / 2, -1.5 + 6 * 0.005)
    assert not explained_by(off, BELOW, SCENE)
    assert not explained_by(point(BELOW, (2.0, 1.7)), BELOW, SCENE)
    assert explained_by(point(BELOW, (2.0, 1.52)), BELOW, SCENE)


def test_a_door_leaf_a_few_degrees_open_is_distinguished_from_the_wall_behind_it():
    ajar = np.array([[[0.0, 0.0], [4.0, 0.0]], [[1.0, 0.05], [1.9, 0.13]]])
    scene = true_identities(ajar)
    pose = Pose(1.5, 1.0)
    alpha = float(np.arctan2(0.9, -0.08))
    d = float(np.array([np.cos(alpha), np.sin(alpha)]) @ ajar[1, 0])
    leaf = explained_by(wall(pose, alpha, d), pose, scene)
    behind = explained_by(wall(pose, np.pi / 2, 0.0), pose, scene)
    assert len(leaf) == len(behind) == 1
    assert leaf.isdisjoint(behind)


def test_a_sighting_of_another_wall_is_a_wrong_match():
    thin, floor = wall(BELOW, -np.pi / 2, -1.5), wall(BELOW, np.pi / 2, 0.0)
    truths = np.tile(BELOW.array(), (3, 1))
    found = judge_matches([{7: thin, 8: floor}, {7: thin}, {7: floor, 8: thin}], truths, SCENE)
    assert found.sightings == 5
    assert found.wrong == ((2, 7), (2, 8))
    assert found.unexplained == ()
    assert found.wrong_per_1000 == pytest.approx(400.0)


def test_wrong_matches_do_not_change_the_identity_of_a_landmark():
    left, right = point(BELOW, (1.0, 1.5)), point(BELOW, (2.0, 1.5))
    found = judge_matches([{1: left}, {1: right}, {1: left}], np.tile(BELOW.array(), (3, 1)), SCENE)
    assert found.wrong == ((1, 1),)


def test_the_first_explained_sighting_gives_a_landmark_its_identity():
    phantom, left, right = (point(BELOW, p) for p in ((3.0, 2.0), (1.0, 1.5), (2.0, 1.5)))
    found = judge_matches([{1: phantom}, {1: left}, {1: right}], np.tile(BELOW.array(), (3, 1)), SCENE)
    assert found.unexplained == ((0, 1),)
    assert found.wrong == ((2, 1),)


def test_an_ambiguous_sighting_is_correct_with_either_identity():
    vague = point(BELOW, (1.5, 1.5), np.diag([0.5**2, 0.5**2]))
    left, right = point(BELOW, (1.0, 1.5)), point(BELOW, (2.0, 1.5))
    truths = np.tile(BELOW.array(), (3, 1))
    assert judge_matches([{1: vague}, {1: left}, {1: vague}], truths, SCENE).wrong == ()
    assert judge_matches([{1: vague}, {1: left}, {1: right}], truths, SCENE).wrong == ((2, 1),)


def test_without_sightings_there_are_no_wrong_matches():
    assert judge_matches([{}], BELOW.array()[None], SCENE).wrong_per_1000 == 0.0
