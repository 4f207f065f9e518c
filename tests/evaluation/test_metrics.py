import itertools
import math

import numpy as np
import pytest
from scipy.stats import chi2

from sixthsense.core.geometry import Array, Pose
from sixthsense.evaluation.metrics import (
    full_rank_from,
    match_landmarks,
    nees_band,
    nees_landmarks,
    true_landmarks,
)


def random_covariances(rng: np.random.Generator, count: int) -> Array:
    a = rng.normal(0, 1, (count, 3, 3))
    return a @ a.transpose(0, 2, 1) + 0.05 * np.eye(3)


def test_rank_is_counted_from_the_first_full_covariance() -> None:
    rng = np.random.default_rng(7)
    full = random_covariances(rng, 1)[0]
    tiny = np.diag([1e-9, 1e-10, 1e-11])
    direction = np.array([1.0, 2.0, 3.0])
    rank_one, turning = np.outer(direction, direction), np.diag([0.0, 0.0, 1.0])
    rank_two = rank_one + np.outer([1.0, 0, 0], [1.0, 0, 0])
    deficient = [np.zeros((3, 3)), turning, rank_one, rank_two]
    assert full_rank_from(np.array([*deficient, full, tiny])) == 4
    assert full_rank_from(np.array([*deficient, tiny, full])) == 4
    assert full_rank_from(np.array(deficient)) == 4
    assert full_rank_from(np.array([full])) == 0
    assert full_rank_from(np.empty((0, 3, 3))) == 0


@pytest.mark.parametrize(("runs", "band"), [(20, (2.02, 4.16)), (50, (2.36, 3.72)), (100, (2.54, 3.50))])
def test_the_band_of_the_mean_nees_is_the_chi_square_one(runs: int, band: tuple[float, float]) -> None:
    assert nees_band(runs) == pytest.approx(band, abs=0.006)
    assert nees_band(10, dof=2, confidence=0.8) == pytest.approx(chi2.ppf((0.1, 0.9), 20) / 10)


def test_the_one_to_one_matching_of_landmarks_has_the_most_pairs() -> None:
    truth = np.array([[0.0, 0.0], [1.0, 0.0], [50.0, 50.0]])
    # Greedily the second estimate takes the first true point, and the first is left with none in reach.
    estimated = np.array([[-0.6, 0.0], [0.4, 0.0], [9.0, 9.0]])
    rmse, matched = match_landmarks(estimated, truth, 0.7)
    assert matched == 2
    assert rmse == pytest.approx(0.6)


def polyline(*points: tuple[float, float]) -> list[list[tuple[float, float]]]:
    return [list(pair) for pair in itertools.pairwise(points)]


@pytest.mark.parametrize(("walls", "expected"), [
    (polyline((0, 0), (4, 0)), [(0, 0), (4, 0)]), (polyline((0, 0), (2, 0), (4, 0)), [(0, 0), (4, 0)]),
    (polyline((0, 0), (3, 0)) + polyline((5, 0), (2, 0)), [(0, 0), (5, 0)]),
    (polyline((0, 0), (4, 0), (4, 3), (0, 3), (0, 0)), [(0, 0), (0, 3), (4, 0), (4, 3)]),
    (polyline((0, 0), (4, 0)) + polyline((2, 0), (2, 3)), [(0, 0), (2, 0), (2, 3), (4, 0)]),
    (polyline((0, 0), (4, 0)) + polyline((2, 1e-4), (2, 3)), [(0, 0), (2, 0), (2, 3), (4, 0)]),
    (polyline((0, 0), (4, 0)) + polyline((2, -1), (2, 3)), [(0, 0), (2, -1), (2, 0), (2, 3), (4, 0)]),
    (polyline((0, 0), (2, 0), (4, 0)) + polyline((2, 0), (2, 3)), [(0, 0), (2, 0), (2, 3), (4, 0)]),
    (polyline((0, 0), (4, 0)) + polyline((0, 0), (4, 0)), [(0, 0), (4, 0)]),
    (polyline((0, 0), (0, 0), (4, 0)), [(0, 0), (4, 0)]),
    (polyline((0, 0), (4, 0)) + polyline((0, 1), (4, 1)), [(0, 0), (0, 1), (4, 0), (4, 1)]),
])  # fmt: skip
def test_true_landmarks_are_ends_corners_and_crossings_but_not_joints_of_a_straight_wall(walls, expected) -> None:
    for turn in (0.0, 0.7, math.pi / 2):
        pose = Pose(3.0, -2.0, turn)
        found = true_landmarks(pose @ np.array(walls, dtype=np.float64))
        back = pose.inverse() @ found
        assert len(back) == len(expected)
        gaps = np.linalg.norm(back[:, None] - np.array(expected)[None], axis=2)
        assert gaps.min(axis=0).max() < 1e-3


def test_the_angle_of_a_wall_is_wrapped_and_the_coordinate_of_a_point_is_not():
    estimate = np.array([[math.pi - 0.01, 2.0], [math.pi, 2.0]])
    truth = np.array([[-math.pi + 0.01, 2.0], [-math.pi, 2.0]])
    found = nees_landmarks(estimate, truth, np.array([True, False]), np.stack([np.eye(2) * 1e-4] * 2))
    np.testing.assert_allclose(found, [4.0, 4.0e4 * math.pi**2], rtol=1e-3)
