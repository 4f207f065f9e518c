"""Of several sets of matches that agree among themselves, the one that explains the scan best is taken."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from sixthsense.slam.association.agreement import agreed, predicted_cov
from sixthsense.slam.association.matching import Innovations, assign, block_diagonal
from sixthsense.slam.association.rivals import _lacking, best_agreed

GATE = 13.8
FACES = 0.05 * np.arange(5)
"""places of the faces of a wall, each 5 cm beside the next, across the wall"""


def stepped_wall(shift, pillar=True):
    """Observations of the last four of five faces, and of a pillar, from a pose believed `shift` too far ahead."""
    seen, known = (np.append(faces, 10.0)[: len(faces) + pillar] for faces in (FACES[1:], FACES))
    return across(seen + shift, known)


def across(seen, known):
    """Observations (m,) of landmarks (k,) by their place across a wall.

    The position across the wall is uncertain by 5 cm; landmarks are known to 1 mm, and observations measure 5 mm.
    """
    m, k = len(seen), len(known)
    by_pose, by_landmark = np.zeros((k, 2, 3)), np.tile(np.eye(2), (k, 1, 1))
    by_pose[:, 1, 1] = -1.0
    joint = np.diag([1e-4, 0.05**2, 1e-6] + [1e-6] * (2 * k))
    values = np.zeros((m, k, 2))
    values[:, :, 1] = seen[:, None] - known[None]
    noise = np.tile(0.005**2 * np.eye(2), (m, k, 1, 1))
    S = np.diag([0.005**2 + 1e-6, 0.05**2 + 0.005**2 + 1e-6])
    squared = np.einsum("mki,mki->mk", values, values @ np.linalg.inv(S))
    log_det = np.full((m, k), np.log(np.linalg.det(S)))
    innovation = Innovations(values, noise, squared, log_det, by_pose, by_landmark, np.zeros((k, 2)), np.ones(k, bool))
    return innovation, predicted_cov(innovation, joint)


@pytest.mark.parametrize("shift", [-0.06, -0.045, 0.0, 0.02])
def test_a_stepped_wall_is_not_matched_with_itself_after_a_shift_that_a_pillar_contradicts(shift):
    innovation, predicted = stepped_wall(shift)
    rows, cols, _ = best_agreed(innovation, predicted, GATE)
    assert dict(zip(rows.tolist(), cols.tolist(), strict=True)) == {0: 1, 1: 2, 2: 3, 3: 4, 4: 5}


def test_the_likeliest_assignment_alone_would_drop_the_pillar():
    innovation, predicted = stepped_wall(-0.045)
    rows, cols, _ = agreed(innovation, predicted, *assign(innovation, GATE), GATE)
    assert dict(zip(rows.tolist(), cols.tolist(), strict=True)) == {0: 0, 1: 1, 2: 2, 3: 3}


def test_of_sets_that_match_all_observations_the_one_with_the_least_innovation_is_taken():
    innovation, predicted = stepped_wall(-0.02, pillar=False)
    rows, cols, _ = best_agreed(innovation, predicted, GATE)
    assert (cols - rows == 1).all()


def test_a_set_gains_nothing_by_an_observation_that_has_no_match_in_the_gate():
    """It may follow from the others. Nothing is denser than its match, and no density is left over for the set."""
    log_det = np.array([[-9.0, -8.0, -3.0], [-5.0, -4.0, -2.0]])
    inside = np.array([[False, True, True], [False, False, False]])
    assert np.array_equal(_lacking(log_det, inside), [[0.0, 0.0, 5.0], [0.0, 0.0, 0.0]])


def test_two_matches_do_not_beat_three_because_one_of_them_lies_outside_its_own_gate():
    """A pillar was moved by 0.19 m, and beside the wall is a face 0.185 m from another: both say the same shift."""
    known = np.array([0.0, 0.1, 0.2, 0.385, 10.0])
    innovation, predicted = across(np.array([0.01, 0.09, 0.2, 9.81]), known)
    assert innovation.squared[3, 4] > GATE > innovation.squared[2, 3]
    rows, cols, _ = best_agreed(innovation, predicted, GATE)
    assert dict(zip(rows.tolist(), cols.tolist(), strict=True)) == {0: 0, 1: 1, 2: 2}


def test_without_a_plausible_pair_nothing_is_matched():
    innovation, predicted = stepped_wall(5.0)
    rows, cols, _ = best_agreed(innovation, predicted, GATE)
    assert len(rows) == len(cols) == 0


def test_blocks_lie_along_the_diagonal():
    blocks = np.random.default_rng(1).normal(size=(4, 2, 2))
    assert np.array_equal(block_diagonal(blocks), block_diag(*blocks))
    assert block_diagonal(blocks[:0]).shape == (0, 0)
