"""Scenes in which an observation can be of the wrong wall, or of two.

An observation here is an ideal one unless it is extracted from a simulated scan: its returns are given by where they
hit. The NIS of true pairs is 2 with all pairs; with the survivors of the gates alone it is too small.
"""

import dataclasses

import numpy as np
import pytest
from predicted import predict_points

from sixthsense.config import Config, LaserConfig, LaserNoise, merge
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.evaluation.matches import judge_matches, landmark_identities
from sixthsense.evaluation.true_identities import TrueLaser, identify, true_identities
from sixthsense.slam.features import extract

MOUNT = (0.35, -0.2, 0.7)
LASER = TrueLaser(LaserConfig(mount=MOUNT), LaserNoise(range_m=0.012, bearing_rad=0.001))
COV = np.diag([0.01**2, 0.005**2])

# Two rooms side by side, 0.2 m of solid between them; a wall that stands free, thin; a wall in two pieces in line.
WALLS = np.array([
    [[0.0, 0.0], [4.0, 0.0]], [[6.0, 0.0], [9.0, 0.0]], [[4.0, 0.0], [4.0, 3.0]], [[4.2, 0.0], [4.2, 3.0]],
    [[1.0, 1.5], [2.0, 1.5]],
])  # fmt: skip
SCENE = true_identities(WALLS)
BELOW, ABOVE = Pose(1.5, 0.8, 0.4), Pose(1.5, 2.2, -0.3)


def bearings_of(pose, places):
    """Bearings from the laser of a robot to places (B, 2) in the world."""
    seen, _, _ = predict_points(pose @ Pose(*MOUNT), np.asarray(places, dtype=float))
    return np.arctan2(seen[:, 1], seen[:, 0])


def between(a, b, count):
    """Places (count, 2) spread evenly from a to b, without the ends."""
    return np.linspace(a, b, count + 2)[1:-1]


def wall(pose, places, cov=COV):
    """An observation of a wall by returns at places (B, 2); what it states of the wall is of no account."""
    return Observation(Kind.WALL, np.array([0.1, -1.0]), cov, (-0.5, 0.5), bearings_of(pose, places))


def end(pose, position, inwards, cov=COV):
    """An observation of a free end at `position` by five returns beside it, up to `inwards`."""
    z = predict_points(pose, np.array([position], dtype=float))[0][0]
    return Observation(Kind.END, z, cov, bearings=bearings_of(pose, between(position, inwards, 5)))


def verdict(observation, pose, scene=SCENE):
    return identify([observation], pose, scene, LASER)[0]


def judged(scans, poses, scene=SCENE):
    return judge_matches(scans, np.array([pose.array() for pose in poses]), scene, LASER)


def test_the_sides_of_a_thin_wall_are_two_identities():
    from_below = verdict(wall(BELOW, between([1.0, 1.5], [2.0, 1.5], 20)), BELOW)
    from_above = verdict(wall(ABOVE, between([1.0, 1.5], [2.0, 1.5], 20)), ABOVE)
    assert from_below.verdict == from_above.verdict == "single"
    assert from_below.identity != from_above.identity
    assert from_below.identity[1] == from_above.identity[1]


def test_a_match_of_a_parallel_face_five_centimetres_away_is_wrong_whatever_covariance_it_states():
    step = np.array([[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.05], [4.0, 0.05]]])
    scene, pose = true_identities(step), Pose(2.0, 1.5, -1.0)
    first = wall(pose, between([0.2, 0.0], [1.9, 0.0], 30))
    places = between([2.1, 0.05], [3.8, 0.05], 30)
    for scale in (1.0, 1e2, 1e4):
        found = judged([{0: first}, {0: wall(pose, places, COV * scale)}], [pose, pose], scene)
        assert found.wrong == ((1, 0),)
        assert found.left_out == ()


def test_an_observation_over_two_faces_spans_and_is_not_right_whatever_covariance_it_states():
    step = np.array([[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.05], [4.0, 0.05]]])
    scene, pose = true_identities(step), Pose(2.0, 1.5, -1.0)
    both = np.concatenate([between([0.5, 0.0], [2.0, 0.0], 20), between([2.0, 0.05], [3.5, 0.05], 20)])
    one = wall(pose, between([0.5, 0.0], [1.9, 0.0], 20))
    found = judged([{0: wall(pose, both, COV * 1e4)}, {0: one}, {0: wall(pose, both)}], [pose] * 3, scene)
    assert found.spanning == ((0, 0), (2, 0))
    assert found.wrong == ()


@pytest.mark.parametrize("mount", [MOUNT, (1.6, -1.2, 0.7)])
def test_an_observation_over_a_bend_spans_unless_its_fit_is_too_short_to_show_it(mount, monkeypatch):
    monkeypatch.setitem(globals(), "MOUNT", mount)
    monkeypatch.setitem(globals(), "LASER", TrueLaser(LaserConfig(mount=mount), LASER.noise))
    turn = np.deg2rad(1.4)
    tip = np.array([3.0, 0.0]) + 3.0 * np.array([np.cos(turn), np.sin(turn)])
    scene, pose = true_identities(np.array([[[0.0, 0.0], [3.0, 0.0]], [[3.0, 0.0], tip]])), Pose(3.0, 2.0, 0.3)
    assert len(scene.lines) == 2
    long = np.concatenate([between([0.2, 0.0], [3.0, 0.0], 40), between([3.0, 0.0], tip, 40)])
    near = np.array([3.0, 0.0]) + 0.3 * (tip - [3.0, 0.0]) / 3.0
    short = np.concatenate([between([2.7, 0.0], [3.0, 0.0], 5), between([3.0, 0.0], near, 5)])
    assert verdict(wall(pose, long), pose, scene).verdict == "spanning"
    assert verdict(wall(pose, short), pose, scene).verdict == "left out"
    beyond, before = wall(pose, between([3.0, 0.0], near, 8)), wall(pose, between([2.7, 0.0], [3.0, 0.0], 8))
    found = judged([{0: before}, {0: beyond}], [pose] * 2, scene)
    assert found.wrong == ()
    assert found.left_out == ((1, 0),)


def test_the_identity_of_a_point_is_the_end_of_the_wall_that_its_returns_hit():
    left, right = (verdict(end(BELOW, p, (1.5, 1.5)), BELOW) for p in ((1.0, 1.5), (2.0, 1.5)))
    assert left.verdict == right.verdict == "single"
    assert left.identity != right.identity
    assert verdict(end(BELOW, (2.03, 1.5), (1.5, 1.5)), BELOW).identity == right.identity
    assert verdict(end(BELOW, (2.1, 1.6), (1.5, 1.5)), BELOW).verdict == "unexplained"


def test_an_observation_of_another_wall_is_a_wrong_match():
    thin, floor = (wall(BELOW, between(*ends, 20)) for ends in (([1, 1.5], [2, 1.5]), ([1, 0], [2, 0])))
    found = judged([{7: thin, 8: floor}, {7: thin}, {7: floor, 8: thin}, {7: floor}], [BELOW] * 4)
    assert found.observations == 6
    assert found.wrong == ((2, 7), (2, 8), (3, 7))
    assert found.unexplained == found.spanning == found.left_out == ()


def test_a_landmark_is_what_most_of_its_observations_are_of_and_nothing_if_most_are_of_several_walls():
    step = np.array([[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.05], [4.0, 0.05]]])
    scene, pose = true_identities(step), Pose(2.0, 1.5, -1.0)
    near, far = between([0.2, 0.0], [1.9, 0.0], 30), between([2.1, 0.05], [3.8, 0.05], 30)
    first, second, both = (wall(pose, places) for places in (near, far, np.concatenate([near, far])))
    scans = [{3: first, 4: first, 5: first}, {3: second, 4: both, 5: second}, {3: second, 4: both}]
    found = landmark_identities(scans, np.array([pose.array()] * 3), scene, LASER)
    assert found == {3: verdict(second, pose, scene).identity}


def random_room(rng):
    """A rectangle of 3 to 9 m, turned at random, its segments (4, 2, 2), and a pose at least 0.9 m from its walls."""
    size, frame = rng.uniform(3.0, 9.0, 2), Pose(*rng.uniform(-5.0, 5.0, 2), rng.uniform(-np.pi, np.pi))
    corners = frame @ (np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * size)
    inside = frame @ rng.uniform(0.9, size - 0.9)[None]
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), Pose(*inside[0], rng.uniform(-np.pi, np.pi))


@pytest.mark.parametrize("landmarks", ["both", "corners"])
def test_every_observation_in_a_convex_room_with_right_angles_is_of_one_wall_or_corner(landmarks):
    config = merge(Config(), {"laser": {"mount": MOUNT}})
    features = dataclasses.replace(config.features, landmarks=landmarks)
    bearings, rng = beam_bearings(config.laser), np.random.default_rng(3)
    observations = 0
    for _ in range(150):
        walls, pose = random_room(rng)
        ranges = cast_rays(pose @ Pose(*MOUNT), bearings, walls, config.laser.max_range)
        scan = Scan.from_config(ranges + rng.normal(0.0, config.world.laser.range_m, len(ranges)), config.laser)
        scene = true_identities(walls)
        for one in identify(extract(scan, config.assumed, features, rng).observations, pose, scene, LASER):
            observations += 1
            assert one.verdict == "single"
    assert observations > 400


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [(20, 2, "single"), (20, 3, "spanning"), (40, 4, "single"), (40, 5, "spanning"), (2, 2, "unexplained")],
)
def test_a_second_wall_counts_from_three_returns_and_a_tenth_of_them_on(one, other, expected):
    """A wall of two pieces half a metre apart."""
    step = np.array([[[0.3, 0.2], [2.3, 0.2]], [[2.3, -0.3], [4.3, -0.3]]])
    pose = Pose(2.4, 2.1, -1.1)
    places = np.concatenate([between([0.5, 0.2], [2.0, 0.2], one), between([2.8, -0.3], [4.0, -0.3], other)])
    assert verdict(wall(pose, places), pose, true_identities(step)).verdict == expected


def test_the_ideal_fit_is_weighted_least_squares_of_the_returns_and_what_is_out_of_range_is_not_hit():
    """Both Jacobians of a return's distance from the line by differences."""
    pose, places = Pose(7.3, 1.9, 2.2), between([6.3, 0.0], [8.7, 0.0], 9)
    found = verdict(wall(pose, places), pose)
    at = (pose @ Pose(*MOUNT)).position
    information = np.zeros((2, 2))
    for ray in places - at:
        reach, bearing = np.hypot(*ray), np.arctan2(ray[1], ray[0])

        def off(alpha, d, reach=reach, bearing=bearing):
            return reach * np.cos(bearing - alpha) - d

        line, h = (0.5 * np.pi, -at[1]), 1e-6
        by_range = (off(*line, reach=reach + h) - off(*line)) / h
        by_bearing = (off(*line, bearing=bearing + h) - off(*line)) / h
        by_line = np.array([off(line[0] + h, line[1]) - off(*line), off(line[0], line[1] + h) - off(*line)]) / h
        information += np.outer(by_line, by_line) / ((0.012 * by_range) ** 2 + (0.001 * by_bearing) ** 2)
    np.testing.assert_allclose(found.fit_cov, np.linalg.inv(information), rtol=1e-3)
    assert found.identity == ("front", 0) or found.identity == ("back", 0)
    far = Pose(7.3, 11.5, 2.2)
    assert verdict(wall(far, places), far).verdict == "unexplained"
    half_widths = TrueLaser(LaserConfig(), LaserNoise("uniform", 0.03, 0.006))
    assert half_widths.sigmas == pytest.approx((0.03 / 3**0.5, 0.006 / 3**0.5))
