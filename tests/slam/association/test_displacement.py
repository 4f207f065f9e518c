"""Landmarks seen anew, from another side or at another stretch, and how far these are off."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation, WallShape
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.displacement import Displacement
from sixthsense.slam.association.matching import Innovations
from sixthsense.slam.association.records import Footprint, Record, unit_cov
from sixthsense.slam.estimators import make_estimator

SIGMA_M, SIGMA_RAD = 0.003, 0.015
"""of an observed wall at its middle"""


def innovation(rng, unit, square_m2):
    """Squared innovation of a landmark seen anew, whose two sights are each off by a mean square, and its gain."""
    root = rng.normal(0.0, 0.006, (2, 2))
    S = root @ root.T + 2e-5 * np.eye(2)
    value = rng.multivariate_normal(np.zeros(2), S + 2.0 * square_m2 * unit)
    return value @ np.linalg.solve(S, value), 0.5 * np.trace(np.linalg.solve(S, unit))


@pytest.mark.parametrize(
    ("unit", "size_m"), [(np.eye(2), 0.005), (np.eye(2), 0.007), (unit_cov(-0.4, 1.5, True), 0.003)]
)
def test_the_size_of_a_displacement_is_what_the_innovations_exceed_their_covariance_by(unit, size_m):
    """Of 400 landmarks; what exceeds three sigmas of chance is counted, so that the size is a little too small."""
    found = []
    for seed in range(10):
        rng, displacement = np.random.default_rng(seed), Displacement()
        for _ in range(400):
            displacement.add(*innovation(rng, unit, size_m**2))
        found.append(math.sqrt(displacement.square_m2))
    assert 0.7 * size_m < np.mean(found) < 1.03 * size_m


def test_where_landmarks_are_not_displaced_nothing_is_counted():
    """In 40 drives past 150 landmarks a threshold of three sigmas is passed at most once."""
    passed = 0
    for seed in range(40):
        rng, displacement = np.random.default_rng(100 + seed), Displacement()
        for _ in range(150):
            displacement.add(*innovation(rng, np.eye(2), 0.0))
        passed += displacement.square_m2 > 0.0
    assert passed <= 1


def test_a_sight_counts_by_the_probability_that_it_is_of_this_landmark():
    one, two = Displacement(), Displacement()
    assert one.square_m2 == 0.0
    for _ in range(30):
        one.add(7.3, 2.0e4)
        two.add(7.3, 2.0e4, 0.6)
        two.add(41.0, 3.0e5, 0.0)
    counts = 30 * (1 - 0.998**30) / (30 * 0.002)
    # Of chance: Wilson and Hilferty's limit for twice as many squares.
    limit = (1.0 - 1.0 / (9 * counts) + 3.0 / math.sqrt(9 * counts)) ** 3
    assert one.square_m2 == pytest.approx(0.5 * (3.65 - limit) / 2.0e4, rel=1e-6)
    assert 0.0 < two.square_m2 < one.square_m2


def test_a_stretch_is_new_if_it_was_seen_neither_just_before_nor_ever():
    record = Record(Kind.WALL, 1, 0, 0)
    here = Pose(0.6, -2.1, 0.4)

    def seen(first, last):
        """A stretch of y = 0.3 from `first` to `last` along x."""
        z = np.array([wrap_angle(math.pi / 2 - here.theta), 0.3 - here.y])
        return Observation(Kind.WALL, z, np.diag([1e-5, 1e-5]), (here.x - last, here.x - first))

    assert not record.is_new_stretch(here, seen(0.0, 1.0))  # of an earlier run: nobody knows
    record.footprint = Footprint.of(here, np.array([[0.0, 0.3], [1.0, 0.3]]))
    record.stretch_of(record.footprint)
    assert not record.is_new_stretch(here, seen(0.1, 1.2))
    assert record.is_new_stretch(here, seen(0.5, 2.0))
    for step in (0.3, 0.6, 0.9, 1.2):
        assert not record.is_new_stretch(here, seen(step, 1.0 + step))
        record.seen_again(seen(step, 1.0 + step), here, np.array([math.pi / 2, 0.3]))
    assert not record.is_new_stretch(here, seen(0.0, 1.0))


def half_of(pose, first, last, off, rng):
    """The stretch of y = 0 from `first` to `last` as it is seen from below, off by `off`, m and rad, and by noise."""
    alpha = math.pi / 2 - pose.theta
    along = np.array([-math.sin(alpha), math.cos(alpha)])
    low, high = sorted((pose.inverse() @ np.array([(first, 0.0), (last, 0.0)]) @ along).tolist())
    middle = 0.5 * (low + high)
    shift_m, turn_rad = off + np.array([SIGMA_M, SIGMA_RAD]) * rng.standard_normal(2)
    cov = np.array([[1.0, middle], [middle, middle**2]]) * SIGMA_RAD**2 + np.diag([0.0, SIGMA_M**2])
    z = np.array([wrap_angle(alpha + turn_rad), -pose.y + shift_m + middle * turn_rad])
    return Observation(Kind.WALL, z, cov, (low, high))


def corridor(seed, size_m):
    """The associator after a drive past 80 walls, of each of which one half is seen and then the other.

    And the last observation, without and with what the associator says of it.
    """
    rng = np.random.default_rng(seed)
    pose = Pose(0.7, -1.4, 0.3)
    estimator = make_estimator("ekf-invariant", pose, np.zeros((3, 3)))
    associator = Associator(AssociationConfig(cull_below=0))
    for k in range(80):
        for half in range(2):
            first = 2.1 * k + 0.8 * half
            off = size_m * rng.standard_normal(2) * (1.0, math.sqrt(12.0) / 0.8)  # as `unit_cov` has it
            for _ in range(3):
                seen = half_of(pose, first, first + 0.8, off, rng)
                told = associator.associate([seen], estimator).observations
                estimator.update(told)
        before, pose = pose, Pose(pose.x + 2.1, pose.y, pose.theta)
        estimator.predict(Odometry(before.inverse() @ pose, np.diag([1e-12, 1e-12, 1e-14])))
    return associator, seen, next(iter(told.values()))


@pytest.mark.parametrize("size_m", [0.0, 0.005])
def test_walls_that_bend_between_two_stretches_make_new_stretches_less_certain(size_m):
    found = [corridor(seed, size_m) for seed in range(3)]
    sizes_m = [math.sqrt(associator._of_stretches.square_m2) for associator, _, _ in found]
    if size_m == 0.0:
        assert sizes_m == [0.0, 0.0, 0.0]
        return
    assert all(0.6 * size_m < size < 1.05 * size_m for size in sizes_m)
    for (_, seen, told), size in zip(found, sizes_m, strict=True):
        np.testing.assert_allclose(told.cov, seen.cov + size**2 * unit_cov(*seen.extent, True), rtol=1e-9)
        np.testing.assert_allclose(told.bend.cov, told.cov - seen.cov, rtol=1e-9)


def test_what_a_crooked_wall_explains_at_another_stretch_is_no_displacement(monkeypatch):
    rng, pose, given = np.random.default_rng(8), Pose(0.7, -1.4, 0.3), []
    estimator = make_estimator("ekf-invariant", pose, np.zeros((3, 3)))
    associator = Associator(AssociationConfig())
    without = Innovations.without

    def kept(self, observation, j, cov, unit):
        given.append((observation, cov))
        return without(self, observation, j, cov, unit)

    monkeypatch.setattr(Innovations, "without", kept)
    shape = WallShape((0.013, -0.006), (2e-6, 3e-6))
    for half in (0, 0, 0, 1):
        seen = half_of(pose, 0.8 * half, 0.8 * half + 0.8, np.zeros(2), rng)
        told = associator.associate([replace(seen, shape=shape)], estimator).observations
        square_m2 = associator.records[0].shape.square_m2(associator._crookedness.excess)
        estimator.update(told)
    ((seen, cov),) = given
    assert square_m2 > 1.5e-4  # nearly the sum of the squares of both amplitudes
    np.testing.assert_allclose(cov - seen.cov, square_m2 * unit_cov(*seen.extent, True), rtol=0.1)


def posts(seed, size_m):
    """The associator after 120 points were seen from two sides, each of which shows them elsewhere."""
    rng = np.random.default_rng(seed)
    noise = np.diag([0.003, 0.0045]) ** 2
    here, there = Pose(0.4, -2.3, 0.7), Pose(-0.6, 3.1, -1.9)
    estimator = make_estimator("ekf-invariant", here, np.zeros((3, 3)))
    associator = Associator(AssociationConfig(cull_below=0))
    moved = Odometry(here.inverse() @ there, np.diag([1e-12, 1e-12, 1e-14]))
    back = Odometry(there.inverse() @ here, np.diag([1e-12, 1e-12, 1e-14]))
    for k in range(120):
        point = np.array([0.5 * (k % 12) - 3.0, 0.5 * (k // 12) - 2.2])
        for pose, motion in ((here, moved), (there, back)):
            place = point + size_m * rng.standard_normal(2)
            z = pose.inverse() @ place + rng.multivariate_normal(np.zeros(2), noise)
            estimator.update(associator.associate([Observation(Kind.END, z, noise)], estimator).observations)
            estimator.predict(motion)
    return associator


@pytest.mark.parametrize("size_m", [0.0, 0.006])
def test_points_that_look_elsewhere_from_each_side_are_told_by_how_much(size_m):
    """What is far off is taken for another point, and what chance may exceed is left out: a quarter is missed."""
    sizes_m = [math.sqrt(posts(seed, size_m)._of_sides.square_m2) for seed in range(4)]
    assert np.mean(sizes_m) == pytest.approx(0.76 * size_m, rel=0.05, abs=1e-12)
