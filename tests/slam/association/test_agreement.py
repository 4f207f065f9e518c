"""Matches of a scan agree with each other, and what contradicts all others is no match."""

import numpy as np
import pytest

from sixthsense.slam.association.agreement import agreed, agreeing, predicted_cov, squared_given
from sixthsense.slam.association.matching import Innovations, stacked_jacobian

GATE = 13.8


def case(rng, m=4):
    """Innovations of m points, a joint covariance, and the covariances of the observations, all pairs plausible."""
    by_pose, by_landmark = rng.normal(size=(m, 2, 3)), np.tile(np.eye(2), (m, 1, 1))
    root = 0.1 * rng.normal(size=(3 + 2 * m, 3 + 2 * m))
    joint = root @ root.T
    noise = np.tile(0.02 * np.eye(2), (m, m, 1, 1))
    H = stacked_jacobian(by_pose, by_landmark)
    S = H @ joint @ H.T + 0.02 * np.eye(2 * m)
    own = rng.multivariate_normal(np.zeros(2 * m), S).reshape(m, 2)
    values = np.tile(own[:, None], (1, m, 1)) + 5.0 * rng.normal(size=(m, m, 2))
    values[np.arange(m), np.arange(m)] = own
    squared = np.einsum("mki,mki->mk", values, values)
    innovation = Innovations(
        values, noise, squared, np.zeros((m, m)), by_pose, by_landmark, np.zeros((m, 2)), np.zeros(m, bool)
    )
    return innovation, joint, S


def test_the_covariance_of_the_predictions_is_that_of_the_stacked_jacobian():
    innovation, joint, _ = case(np.random.default_rng(1))
    H = stacked_jacobian(innovation.by_pose, innovation.by_landmark)
    assert predicted_cov(innovation, joint) == pytest.approx(H @ joint @ H.T)


def given_the_others(innovation, S, i):
    """Squared innovation of match i given all others, by the conditional of a Gaussian."""
    m = len(innovation.by_pose)
    stacked = innovation.values[np.arange(m), np.arange(m)].ravel()
    own, rest = np.arange(2 * i, 2 * i + 2), np.delete(np.arange(2 * m), [2 * i, 2 * i + 1])
    gain = S[np.ix_(own, rest)] @ np.linalg.inv(S[np.ix_(rest, rest)])
    off = stacked[own] - gain @ stacked[rest]
    return float(off @ np.linalg.solve(S[np.ix_(own, own)] - gain @ S[np.ix_(rest, own)], off))


@pytest.mark.parametrize("seed", range(5))
def test_a_match_is_judged_by_what_the_others_say_of_it(seed):
    innovation, joint, S = case(np.random.default_rng(seed))
    squared = [given_the_others(innovation, S, i) for i in range(4)]
    worst = int(np.argmax(squared))
    every = np.arange(4)
    predicted = predicted_cov(innovation, joint)
    rows, _ = agreeing(innovation, predicted, every, every, max(squared) * 1.001)
    assert rows.tolist() == [0, 1, 2, 3]
    rows, _ = agreeing(innovation, predicted, every, every, max(squared) * 0.999)
    assert worst not in rows
    others = np.delete(every, worst)
    assert squared_given(innovation, predicted, others, others)[worst, worst] == pytest.approx(squared[worst])


def test_correct_matches_are_vetoed_as_seldom_as_the_gate_says():
    rng, vetoed, total = np.random.default_rng(2), 0, 0
    every = np.arange(4)
    for _ in range(1000):
        innovation, joint, _ = case(rng)
        rows, _ = agreeing(innovation, predicted_cov(innovation, joint), every, every, 9.21)
        vetoed, total = vetoed + 4 - len(rows), total + 4
    assert 0.006 < vetoed / total < 0.014


def walls_at_one_pose(lean):
    """Five walls known well, seen from a pose whose heading is uncertain by 0.1; the first is turned by `lean`."""
    m = 5
    by_pose, by_landmark = np.zeros((m, 2, 3)), np.tile(np.eye(2), (m, 1, 1))
    by_pose[:, 0, 2], by_pose[:, 1, 0] = -1.0, -1.0
    joint = np.diag([0.01, 0.01, 0.01] + [1e-6] * (2 * m))
    values = np.full((m, m, 2), 10.0)
    values[np.arange(m), np.arange(m)] = 0.0
    values[0, 0, 0] = lean
    squared = np.where(np.eye(m, dtype=bool), 0.5, np.inf)
    noise = np.tile(1e-6 * np.eye(2), (m, m, 1, 1))
    return (
        Innovations(values, noise, squared, np.zeros((m, m)), by_pose, by_landmark, np.zeros((m, 2)), np.ones(m, bool)),
        joint,
    )


def test_one_wall_cannot_turn_the_robot_against_all_others():
    every = np.arange(5)
    # 0.06 rad is well inside the gate of the wall for itself.
    innovation, joint = walls_at_one_pose(0.06)
    rows, cols, squared = agreed(innovation, predicted_cov(innovation, joint), every, every, GATE)
    assert rows.tolist() == cols.tolist() == [1, 2, 3, 4]
    assert squared[0, 0] > 100.0


def test_an_observation_that_follows_from_the_others_is_matched():
    innovation, joint = walls_at_one_pose(0.0)
    four = np.arange(1, 5)
    rows, cols, _ = agreed(innovation, predicted_cov(innovation, joint), four, four, GATE)
    assert sorted(rows.tolist()) == sorted(cols.tolist()) == [0, 1, 2, 3, 4]


def test_without_a_match_the_innovations_are_the_single_ones():
    innovation, joint, _ = case(np.random.default_rng(3))
    none = np.zeros(0, dtype=np.int64)
    predicted = predicted_cov(innovation, joint)
    rows, cols = agreeing(innovation, predicted, none, none, GATE)
    assert len(rows) == len(cols) == 0
    squared = squared_given(innovation, predicted, none, none)
    S = predicted[2:4, 2:4] + innovation.noise[0, 1]
    assert squared[0, 1] == pytest.approx(innovation.values[0, 1] @ np.linalg.solve(S, innovation.values[0, 1]))
