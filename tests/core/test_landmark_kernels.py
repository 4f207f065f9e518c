"""The kernels of landmarks compute what plain NumPy does."""

import numpy as np
import pytest

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmark_kernels import innovations_of
from sixthsense.core.landmarks import line_errors


def covariances(rng, n):
    root = rng.normal(size=(n, 2, 2))
    return root @ root.transpose(0, 2, 1)


@pytest.fixture(params=range(5))
def case(request):
    rng = np.random.default_rng(request.param)
    walls = rng.random(12) < 0.5
    landmarks = rng.normal(size=(12, 2)) * 4.0
    landmarks[walls, 0] = wrap_angle(landmarks[walls, 0])
    return rng, Pose(*rng.normal(size=3) * 3.0), landmarks, walls


def test_innovations(case):
    rng, _, predicted, walls = case
    z, cov = predicted + rng.normal(size=predicted.shape), covariances(rng, len(walls))
    values, about = innovations_of(z, cov, predicted, walls)
    turn, (lever, of_turn, of_shift) = wrap_angle(z[:, 0] - predicted[:, 0]), line_errors(cov)
    turned = lever * np.cos(turn) + z[:, 1] * np.sin(turn)
    gap = z[:, 1] * np.cos(turn) - lever * np.sin(turn) - predicted[:, 1] + turned * turn
    assert np.allclose(values, np.where(walls[:, None], np.column_stack([turn, gap]), z - predicted), atol=1e-12)
    mixed = turned * of_turn
    of_wall = np.stack([of_turn, mixed, mixed, of_shift + turned**2 * of_turn], axis=-1).reshape(-1, 2, 2)
    assert np.allclose(about, np.where(walls[:, None, None], of_wall, cov), atol=1e-10)
