"""Joint compatibility against an exhaustive search of all hypotheses."""

import itertools

import numpy as np
import pytest
from scipy.stats import chi2

from sixthsense.slam.association.joint_compatibility import jointly_compatible
from sixthsense.slam.association.matching import Innovations, joint_nis


def problem(seed, observations=4, landmarks=5):
    """Innovations of points near each other, whose predictions share a large pose error."""
    rng = np.random.default_rng(seed)
    by_pose = np.concatenate([np.tile(-np.eye(2), (landmarks, 1, 1)), rng.normal(0, 2, (landmarks, 2, 1))], axis=2)
    by_landmark = np.tile(np.eye(2), (landmarks, 1, 1))
    root = rng.normal(0, 0.05, (3 + 2 * landmarks, 3 + 2 * landmarks))
    joint = root @ root.T + np.diag([0.1, 0.1, 0.01] + [0.01] * (2 * landmarks))
    noise = np.tile(0.01 * np.eye(2), (observations, 1, 1))
    predicted = rng.uniform(-1.5, 1.5, (landmarks, 2))
    z = (
        predicted[rng.permutation(landmarks)[:observations]]
        + rng.normal(0, 0.3, 2)
        + rng.normal(0, 0.1, (observations, 2))
    )
    values = z[:, None] - predicted[None]
    squared = np.empty((observations, landmarks))
    for i, j in np.ndindex(squared.shape):
        index = np.r_[0:3, 3 + 2 * j : 5 + 2 * j]
        sub = joint[np.ix_(index, index)]
        squared[i, j] = joint_nis(sub, by_pose[j : j + 1], by_landmark[j : j + 1], values[i, j], noise[i : i + 1])
    walls = np.zeros(landmarks, dtype=bool)
    pairs = np.repeat(noise[:, None], landmarks, axis=1)
    innovation = Innovations(values, pairs, squared, np.zeros_like(squared), by_pose, by_landmark, predicted, walls)
    return innovation, joint, noise


def nis_of(innovation, joint, noise, pairs):
    rows, cols = np.array(pairs, dtype=int).reshape(-1, 2).T
    index = np.concatenate([np.arange(3), (3 + 2 * cols[:, None] + np.arange(2)).ravel()])
    by_pose, by_landmark = innovation.by_pose[cols], innovation.by_landmark[cols]
    return joint_nis(joint[np.ix_(index, index)], by_pose, by_landmark, innovation.values[rows, cols], noise[rows])


def exhaustive(innovation, joint, noise, gate, probability):
    best = (0, 0.0)
    for choice in itertools.product(range(-1, innovation.squared.shape[1]), repeat=len(noise)):
        pairs = [(i, j) for i, j in enumerate(choice) if j >= 0]
        if len({j for _, j in pairs}) < len(pairs) or any(innovation.squared[p] >= gate for p in pairs):
            continue
        nis = nis_of(innovation, joint, noise, pairs)
        # Every part of a hypothesis that is compatible is so itself but for the order of the chi-square's quantiles.
        if pairs and nis > chi2.ppf(probability, 2 * len(pairs)):
            continue
        if (-len(pairs), nis) < (-best[0], best[1]):
            best = (len(pairs), nis)
    return best


@pytest.mark.parametrize("seed", range(12))
def test_the_largest_jointly_compatible_set_is_found(seed):
    innovation, joint, noise = problem(seed)
    gate = float(chi2.ppf(0.999, 2))
    rows, cols = jointly_compatible(innovation, joint, gate, 0.999)
    count, nis = exhaustive(innovation, joint, noise, gate, 0.999)
    assert len(rows) == count and len(set(cols.tolist())) == len(cols)
    assert nis_of(innovation, joint, noise, np.column_stack([rows, cols])) == pytest.approx(nis, rel=1e-6)


def test_each_alone_may_pass_where_both_together_cannot():
    """Two landmarks observed with opposite shifts: a shift of the robot explains either one, but not both."""
    by_pose, by_landmark = np.tile(np.array([[-1.0, 0, 0], [0, -1.0, 0]]), (2, 1, 1)), np.tile(np.eye(2), (2, 1, 1))
    joint, noise = np.diag([1.0, 1.0, 1e-9] + [1e-4] * 4), np.tile(1e-4 * np.eye(2), (2, 2, 1, 1))
    values = np.full((2, 2, 2), 9.0)
    values[0, 0], values[1, 1] = (0.9, 0.0), (-0.9, 0.0)
    squared = np.where(np.eye(2, dtype=bool), 0.81, np.inf)
    walls = np.zeros(2, dtype=bool)
    innovation = Innovations(values, noise, squared, np.zeros((2, 2)), by_pose, by_landmark, np.zeros((2, 2)), walls)
    rows, _ = jointly_compatible(innovation, joint, 13.8, 0.999)
    assert len(rows) == 1


def test_the_search_ends_in_a_room_full_of_ambiguous_matches(monkeypatch):
    monkeypatch.setattr("sixthsense.slam.association.joint_compatibility._MAX_NODES", 300)
    innovation, joint, _ = problem(1, 14, 14)
    innovation.squared[:] = 1.0
    rows, cols = jointly_compatible(innovation, 100.0 * joint, 13.8, 0.999)
    assert len(rows) and len(set(cols.tolist())) == len(cols)
