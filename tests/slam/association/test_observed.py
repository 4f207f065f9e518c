"""Distances, sigmas, extents and shapes of walls against plain references, for general places and sizes."""

import math

import numpy as np
import pytest

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation, line_point
from sixthsense.slam.association.observed import Distances, Observed, ends, joined
from sixthsense.slam.association.records import Record, less_certain, unit_cov
from sixthsense.slam.estimators.base import Estimate

CONFIG = AssociationConfig(new_separation_m=0.45)
POSE = Pose(-1.7, 2.3, 2.6)


def seen_and_known(rng, count):
    """Observations of random points and walls, and an estimate of other ones with the ends of the walls."""
    walls = rng.random(count) < 0.6
    seen = []
    for is_wall in walls:
        root, first = rng.normal(size=(2, 2)) * 0.1, rng.uniform(-1.0, 0.0)
        z = np.array([rng.uniform(-3, 3), rng.uniform(0.2, 2.0)]) if is_wall else rng.uniform(-2, 2, 2)
        extent = (first, first + rng.uniform(0.3, 2.0)) if is_wall else (0.0, 0.0)
        seen.append(Observation(Kind.WALL if is_wall else Kind.END, z, root @ root.T, extent))
    # Landmarks near what is seen, in another order.
    order = rng.permutation(count)
    landmarks, extents = np.empty((count, 2)), np.zeros((count, 2, 2))
    for k, i in enumerate(order):
        if walls[i]:
            alpha = wrap_angle(seen[i].z[0] + POSE.theta + rng.normal(0.0, 0.1))
            middle = POSE @ line_point(seen[i].z, sum(seen[i].extent) / 2.0) + rng.normal(0.0, 0.4, 2)
            landmarks[k] = alpha, middle @ [math.cos(alpha), math.sin(alpha)]
            lever = middle @ [-math.sin(alpha), math.cos(alpha)]
            shift, half = rng.uniform(-1.5, 1.5), rng.uniform(0.1, 0.7)
            extents[k] = line_point(landmarks[k], lever + shift - half), line_point(landmarks[k], lever + shift + half)
        else:
            landmarks[k] = POSE @ seen[i].z + rng.normal(0.0, 0.5, 2)
    pose_cov = np.diag([0.04, 0.09, 0.0025])
    return seen, Estimate(POSE, pose_cov, np.arange(count), landmarks, walls[order]), extents


@pytest.mark.parametrize("seed", range(6))
def test_distances_from_landmarks_and_what_they_allow_are_those_of_plain_geometry(seed):
    rng = np.random.default_rng(seed)
    seen, estimate, extents = seen_and_known(rng, 9)
    found = Distances.at(POSE, Observed.of(seen), estimate, extents)
    sigmas = rng.uniform(0.02, 0.3, 9)
    plausible, apart = found.plausible(sigmas, 0.05, CONFIG), found.apart(CONFIG)
    widest = math.sqrt(max(CONFIG.match_gate, CONFIG.new_gate))
    for i, one in enumerate(seen):
        points = POSE @ np.array([line_point(one.z, place) for place in one.extent])
        assert found.length_m[i] == pytest.approx(one.extent[1] - one.extent[0])
        for j, landmark in enumerate(estimate.landmarks):
            if one.is_wall != estimate.walls[j]:
                assert found.metres[i, j] == math.inf and apart[i, j] and not plausible[i, j]
                continue
            away, turn, gap = math.dist(POSE @ one.z, landmark), 0.0, -math.inf
            limit = widest * (sigmas[i] + 0.3)
            if one.is_wall:
                normal = np.array([math.cos(landmark[0]), math.sin(landmark[0])])
                along = np.array([-normal[1], normal[0]])
                away = abs(points.mean(axis=0) @ normal - landmark[1])
                turn = abs(wrap_angle(one.z[0] + POSE.theta - landmark[0]))
                a, b = sorted(points @ along), sorted(extents[j] @ along)
                gap = max(a[0], b[0]) - min(a[1], b[1])
                limit = max(widest * sigmas[i], 0.45)
            assert (found.metres[i, j], found.turn_rad[i, j], found.gap_m[i, j]) == pytest.approx((away, turn, gap))
            assert apart[i, j] == (away > 0.45 or turn >= 0.15 or gap >= 0.05)
            assert plausible[i, j] == (away < limit and turn < max(0.05 * widest, 0.15) and gap < 0.05)


def test_the_bound_of_a_sigma_is_that_of_the_middle_seen_with_the_errors_of_the_pose_added():
    seen, estimate, _ = seen_and_known(np.random.default_rng(11), 8)
    for one, found in zip(seen, Observed.of(seen).sigmas_m(estimate.pose_cov), strict=True):
        lever = sum(one.extent) / 2.0
        own, middle = math.sqrt(np.trace(one.cov)), one.z
        if one.is_wall:
            across = np.array([-lever, 1.0])  # of its middle, by alpha and d
            own, middle = math.sqrt(across @ one.cov @ across), line_point(one.z, lever)
        assert found == pytest.approx(own + 0.05 * math.hypot(*middle) + math.sqrt(0.13))


def test_extents_are_joined_on_the_landmark_from_the_first_place_to_the_last():
    landmark = np.array([-2.2, 1.4])
    off = 0.1 * np.array([math.cos(-2.2), math.sin(-2.2)])
    first, second = (np.array([line_point(landmark, s) + off for s in span]) for span in ((0.9, -0.3), (0.2, 1.6)))
    expected = [line_point(landmark, -0.3), line_point(landmark, 1.6)]
    assert joined(landmark, first, second) == pytest.approx(np.array(expected))
    wall = Observation(Kind.WALL, np.array([0.4, 1.1]), np.eye(2), (-0.5, 0.8))
    assert ends(POSE, wall) == pytest.approx(np.array([POSE @ line_point(wall.z, s) for s in wall.extent]))


def test_a_crooked_wall_is_uncertain_by_its_mean_square_and_a_tilt_of_thrice_that_at_its_ends():
    cov = unit_cov(0.4, 2.8, True)
    for place in (0.4, 1.6, 2.2, 2.8):
        across = np.array([-place, 1.0])
        assert across @ cov @ across == pytest.approx(1.0 + 3.0 * ((place - 1.6) / 1.2) ** 2)
    wall = Observation(Kind.WALL, np.array([0.4, 1.1]), np.diag([0.01, 0.02]), (0.4, 2.8))
    record = Record(Kind.WALL, 3, 0, 0, square_m2=0.003, looks=2)
    shape = 0.003 * cov
    own = wall.cov + 3 * shape + 2 * shape @ np.linalg.inv(wall.cov) @ shape
    assert less_certain(wall, record).cov == pytest.approx(own)
    np.testing.assert_array_equal(unit_cov(0.4, 2.8, False), np.eye(2))  # a point is off along any axis
