"""Points as they appear: the part of their error that stays while the side stays, and how large it is."""

import math

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.landmarks import Bend, Kind, Observation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.motion import Odometry
from sixthsense.core.ray_casting import cast_rays
from sixthsense.slam.association.corners import Corner, Scatter, Sight, kept_between
from sixthsense.slam.features import extract
from sixthsense.testing.apparent import NEW, STAYS, cov_of, seen_from

FILTERS = ["ekf", "ekf-fej", "ekf-oc", "ekf-invariant"]
POINT = np.array([2.3, 1.7])
ALONG, ACROSS = 0.03, 0.004
WALL_RAD = 0.6
AXIS = np.array([math.cos(WALL_RAD), math.sin(WALL_RAD)])
COV = rotation(WALL_RAD) @ np.diag([ALONG**2, ACROSS**2]) @ rotation(WALL_RAD).T


def pose_at(side_rad, away_m=41.0):
    """A robot that sees the point from a side."""
    place = POINT + away_m * np.array([math.cos(side_rad), math.sin(side_rad)])
    return Pose(*place, side_rad + 2.8)


def seen(pose, error):
    """The free end with an error (2,), world axes."""
    to_robot = rotation(-pose.theta)
    return Observation(Kind.END, to_robot @ (POINT + error - pose.position), to_robot @ COV @ to_robot.T)


def looks(rng, stays_m, sides, count):
    """The bends of a point that is seen `count` times from each side, where the error of the side is `stays_m`."""
    corner, scatter, bends = Corner(), Scatter(), []
    rest = math.sqrt(ALONG**2 - stays_m**2)
    for side in sides:
        common = stays_m * rng.standard_normal()
        for _ in range(count):
            error = (common + rest * rng.standard_normal()) * AXIS + ACROSS * rng.standard_normal() * np.array([-1, 1])
            bends.append(corner.seen(seen(pose_at(side), error), pose_at(side), scatter, 0.0).bend)
    return bends, scatter


def test_a_sight_is_in_the_world_with_the_axis_of_its_largest_error():
    pose = pose_at(1.9)
    sight = Sight.of(seen(pose, np.array([0.02, -0.01])), pose)
    np.testing.assert_allclose(sight.place, POINT + np.array([0.02, -0.01]), atol=1e-12)
    np.testing.assert_allclose(sight.cov, COV, atol=1e-15)
    assert abs(sight.axis @ AXIS) == pytest.approx(1.0) and sight.sigma_m == pytest.approx(ALONG)
    towards = pose.position - sight.place
    assert sight.side_rad == pytest.approx(math.atan2(towards[1], towards[0]))
    assert sight.incidence == int(5 * abs(AXIS @ towards) / np.hypot(*towards))


def test_errors_from_two_sides_are_alike_by_the_turn_between_them_across_the_half_turn():
    assert kept_between(3.1, -3.05) == pytest.approx(math.exp(-(((2 * math.pi - 6.15) / 0.2) ** 2)))


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_the_part_that_stays_is_what_the_scatter_lacks(share):
    rng = np.random.default_rng(3)
    scatter = Scatter()
    for _ in range(40):
        corner, side = Corner(), WALL_RAD + 0.5 * math.pi + rng.uniform(-0.1, 0.1)
        common = math.sqrt(share) * ALONG * rng.standard_normal()
        for _ in range(12):
            error = (common + math.sqrt(1.0 - share) * ALONG * rng.standard_normal()) * AXIS
            corner.seen(seen(pose_at(side), error), pose_at(side), scatter, 0.0)
    assert scatter.share(0) == pytest.approx(share, abs=0.12)
    assert [scatter.share(k) for k in range(1, 5)] == [0.0] * 4


def test_where_each_scan_draws_the_error_anew_nothing_stays_and_observations_are_as_they_were():
    """In 20 drives of 60 observations a threshold of three sigmas is passed at most once."""
    found = [looks(np.random.default_rng(seed), 0.0, [2.1, 2.9, 0.4], 20)[0] for seed in range(20)]
    assert sum(any(bend is not None for bend in bends) for bends in found) <= 1


def test_the_error_stays_while_the_side_stays_and_changes_by_both_when_it_is_left():
    bends, scatter = looks(np.random.default_rng(1), 0.029, [2.17, 2.17, 2.25, 0.3], 60)
    assert bends[0] is None
    share = scatter.share(0)
    assert 0.8 < share < 1.0
    same, other = bends[119], bends[120]
    to_robot = rotation(-pose_at(2.17).theta) @ AXIS
    along = to_robot @ same.cov @ to_robot
    assert along == pytest.approx(share * ALONG**2, rel=0.2) and same.stretch == 0
    assert to_robot @ same.renewal @ to_robot < 0.02 * along
    to_robot = rotation(-pose_at(2.25).theta) @ AXIS
    kept = math.exp(-((0.08 / 0.2) ** 2))
    assert to_robot @ other.renewal @ to_robot == pytest.approx(2.0 * (1.0 - kept) * along, rel=0.1)
    assert other.stretch == 0 and other.stretch_kept == pytest.approx(kept, abs=0.05)
    # Along the wall all of the error is new: what stayed is lost, and takes nothing else with it.
    last = bends[180]
    to_robot = rotation(-pose_at(0.3).theta) @ AXIS
    assert not last.cov.any() and to_robot @ last.renewal @ to_robot == pytest.approx(along, rel=0.2)
    assert bends[181] is None


def test_each_side_has_an_error_of_its_own_that_is_new_where_the_side_changes():
    """Without any scatter that is too small: what a side adds is along all axes alike."""
    corner, scatter, square_m2 = Corner(), Scatter(), 0.006**2
    sights = [corner.seen(seen(pose_at(side), 0.0), pose_at(side), scatter, square_m2) for side in (2.2, 2.1, -0.9)]
    for sight, side, kept in zip(sights, (2.2, 2.1, -0.9), (0.0, math.exp(-0.25), 0.0), strict=True):
        np.testing.assert_allclose(sight.cov, seen(pose_at(side), 0.0).cov + square_m2 * np.eye(2))
        np.testing.assert_allclose(sight.bend.cov, square_m2 * np.eye(2))
        np.testing.assert_allclose(sight.bend.renewal, 2.0 * (1.0 - kept) * square_m2 * np.eye(2), atol=1e-15)
    assert [sight.bend.stretch for sight in sights] == [0, 0, 1]
    assert sights[1].bend.stretch_kept == pytest.approx(math.exp(-0.25), rel=1e-3)


@pytest.mark.parametrize("name", [*FILTERS, "isam2"])
def test_a_point_is_known_no_better_than_by_what_stays_however_often_it_is_seen(name):
    often, once = cov_of(seen_from([0] * 200, name)), cov_of(seen_from([0], name))
    least = np.linalg.eigvalsh(np.linalg.solve(STAYS, often)).min()
    assert 0.98 < least < 1.1
    assert np.linalg.eigvalsh(once - often).min() > 0.5 * np.linalg.eigvalsh(NEW).min()


def test_in_the_smoother_two_sides_say_more_than_one():
    one, two = (cov_of(seen_from(sides, "isam2")) for sides in ([0] * 200, [0, 1] * 100))
    np.testing.assert_allclose(two, 0.5 * one, rtol=0.03)


@pytest.mark.parametrize("name", [*FILTERS, "isam2"])
def test_a_point_that_is_seen_from_another_side_says_less_of_the_pose(name):
    """After a motion that is uncertain, one more sight from the old side or from a new one."""
    found = []
    for side in (0, 1):
        estimator = seen_from([0] * 20, name)
        estimator.predict(Odometry(Pose(), np.diag([0.04, 0.04, 1e-8])))
        bend = Bend(STAYS, 2.0 * STAYS if side else np.zeros((2, 2)), side)
        estimator.update({5: Observation(Kind.END, np.array([2.1, 1.3]), STAYS + NEW, bend=bend)})
        found.append(estimator.estimate().pose_cov[:2, :2])
    np.testing.assert_allclose(found[0], NEW * 1.05, rtol=0.25, atol=3e-6)
    np.testing.assert_allclose(found[1], NEW * 1.05 + 2.0 * STAYS, rtol=0.15)


def test_a_point_with_sides_can_be_forgotten_and_begun_again():
    estimator = seen_from([0, 1, 1, 2], "isam2")
    estimator.forget([5])
    seen_at = np.array([1.1, -0.4])
    estimator.update({5: Observation(Kind.END, seen_at, STAYS + NEW, bend=Bend(STAYS, 2.0 * STAYS, 0))})
    np.testing.assert_allclose(estimator.estimate().landmarks[0], np.array([0.4, -0.7]) + seen_at, atol=1e-4)


def free_end_errors(jamb_m, rng):
    """How far beyond a wall's end, along it, the end is seen from nearly ahead, in sigmas; the wall is so thick."""
    config = preset()
    walls = np.array([[(4.0, -5.0), (4.0, 0.6)], [(4.0, 0.6), (4.0 + jamb_m, 0.6)], [(9.0, -8.0), (9.0, 8.0)]])
    bearings, found = beam_bearings(config.laser), []
    for _ in range(300):
        pose = Pose(rng.uniform(0.0, 0.05), rng.uniform(1.3, 1.4), rng.uniform(-3.0, 3.0))
        ranges = cast_rays(pose, bearings, walls, config.laser.max_range) + rng.normal(0.0, 0.005, len(bearings))
        for end in extract(Scan.from_config(ranges, config.laser), config.assumed, config.features, rng).observations:
            place, cov = pose @ end.z, rotation(pose.theta) @ end.cov @ rotation(pose.theta).T
            if not end.is_wall and np.hypot(*(place - [4.0, 0.6])) < 0.2:
                found.append((place[1] - 0.6) / math.sqrt(cov[1, 1]))
    return np.array(found)


def test_the_end_of_a_thick_wall_is_seen_too_far_and_with_less_scatter_than_that_of_a_thin_one():
    rng = np.random.default_rng(0)
    thin, thick = free_end_errors(0.0, rng), free_end_errors(0.25, rng)
    assert len(thick) < 0.8 * len(thin)
    assert abs(thin.mean()) < 0.2 and thin.var() == pytest.approx(1.0, abs=0.2)
    assert thick.mean() > 0.4 and thick.var() < 0.8
