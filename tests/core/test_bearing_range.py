"""Polar coordinates of an observation: an unbiased mean, and the covariance by the Jacobian."""

import math

import numpy as np
import pytest

from sixthsense.core.geometry import wrap_angle
from sixthsense.core.landmarks import Kind, Observation

COVS = {"across": np.diag([0.1, 1.0]), "correlated": np.array([[1.0, 0.7], [0.7, 0.8]])}


def polar(z):
    return np.array([math.atan2(z[1], z[0]), math.hypot(*z)])


def view(z, cov):
    bearing, distance, _ = Observation(Kind.CORNER, z, cov).bearing_range()
    return np.array([bearing, distance])


def mean_error(z, cov, errors, weights):
    """Errors (bearing, range) of `bearing_range` at z + error, and of the plain change of coordinates."""
    found = [[view(z + e, cov) - polar(z), polar(z + e) - polar(z)] for e in errors]
    found = np.array(found)
    found[..., 0] = wrap_angle(found[..., 0])
    return np.einsum("n,nij->ij", weights, found)


@pytest.mark.parametrize("shape", COVS)
def test_the_remaining_bias_is_of_fourth_order(shape):
    """Half the noise gives a sixteenth of the bias; for the plain change of coordinates a quarter."""
    z = np.array([1.2, -1.6])
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    grid = np.stack(np.meshgrid(nodes, nodes), axis=-1).reshape(-1, 2)
    weight = np.outer(weights, weights).ravel() / weights.sum() ** 2
    left = []
    for sigma in (0.1, 0.05):
        cov = COVS[shape] * sigma**2
        freed, plain = mean_error(z, cov, grid @ np.linalg.cholesky(cov).T, weight)
        left.append([np.linalg.norm(freed), np.linalg.norm(plain)])
    ratio = np.divide(*left)
    assert 14.0 < ratio[0] < 18.0 and 3.8 < ratio[1] < 4.2


def test_the_polar_covariance_agrees_with_finite_differences():
    rng = np.random.default_rng(1)
    for _ in range(30):
        z, root = rng.normal(0, 3, 2), rng.normal(0, 0.1, (2, 2))
        cov = root @ root.T
        columns = [(polar(z + h) - polar(z - h)) for h in 1e-6 * np.eye(2)]
        jacobian = np.column_stack([[wrap_angle(c[0]), c[1]] for c in columns]) / 2e-6
        found = Observation(Kind.CORNER, z, cov).bearing_range()[2]
        assert np.allclose(found, jacobian @ cov @ jacobian.T, rtol=1e-6, atol=1e-10)
        assert np.array_equal(found, found.T)


@pytest.mark.parametrize("r", [0.0, 1e-12, 1e-3, 0.05, 0.1])
def test_a_point_nearer_than_its_own_error_has_a_range_and_a_covariance(r: float) -> None:
    bearing, distance, cov = Observation(Kind.CORNER, np.array([r, 0.0]), np.eye(2) * 0.01).bearing_range()
    assert np.isfinite([bearing, distance]).all() and 0.0 < distance <= max(r, 0.05)
    assert np.linalg.eigvalsh(cov).min() > 0.0 and math.sqrt(cov[0, 0]) <= math.pi + 1e-9
