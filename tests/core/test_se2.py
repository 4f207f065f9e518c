"""SE(2) by triples, rows and `Pose`: the same as homogeneous matrices; covariances by numerical Jacobians."""

import math

import numpy as np
import pytest

from sixthsense.core.geometry import wrap_angle
from sixthsense.core.se2 import Triple, between, compose, inverse, inverse_covariance, whitening, wrapped

RNG = np.random.default_rng(5)
ONE, MANY = RNG.uniform(-4, 4, size=3), RNG.uniform(-4, 4, size=(7, 3))


def random_triple() -> Triple:
    x, y = RNG.uniform(-50.0, 50.0, 2)
    return float(x), float(y), float(RNG.uniform(-math.pi, math.pi))


def matrix(pose: Triple) -> np.ndarray:
    """(3, 3) homogeneous."""
    x, y, theta = pose
    return np.array([[math.cos(theta), -math.sin(theta), x], [math.sin(theta), math.cos(theta), y], [0.0, 0.0, 1.0]])


def assert_is(found: Triple, expected: np.ndarray) -> None:
    assert np.allclose(matrix(found), expected, rtol=0.0, atol=1e-12)
    assert -math.pi <= found[2] < math.pi


def test_triples_are_composed_inverted_and_compared_as_matrices() -> None:
    for _ in range(200):
        a, b = random_triple(), random_triple()
        assert_is(compose(a, b), matrix(a) @ matrix(b))
        assert_is(inverse(a), np.linalg.inv(matrix(a)))
        assert_is(between(a, b), np.linalg.inv(matrix(a)) @ matrix(b))


@pytest.mark.parametrize(("a", "b"), [(ONE, MANY), (MANY, ONE), (MANY, MANY[::-1]), (ONE, MANY[0]), (ONE, MANY[:0])])
def test_rows_of_poses_are_composed_as_triples(a: np.ndarray, b: np.ndarray) -> None:
    rows = np.broadcast_shapes(a.shape, b.shape)
    pairs = list(zip(np.broadcast_to(a, rows).reshape(-1, 3), np.broadcast_to(b, rows).reshape(-1, 3), strict=True))
    for function in (compose, between, lambda x, y: compose(inverse(x), y)):
        expected = np.array([function(tuple(x), tuple(y)) for x, y in pairs]).reshape(rows)
        assert np.allclose(function(a, b), expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("angle", [0.3, -3.2, 7.0, np.pi, -np.pi, 3 * np.pi, -np.pi - 1e-17, np.nextafter(-np.pi, -4)])
def test_an_angle_keeps_its_direction_and_comes_into_half_a_turn_on_either_side(angle: float) -> None:
    found = wrapped(angle)
    assert -math.pi <= found < math.pi
    assert abs(math.remainder(found - angle, 2.0 * math.pi)) < 1e-12
    assert found == wrap_angle(angle) == wrap_angle(np.array([angle, 1.0]))[0]


def covariances_of_any_shape(count: int) -> np.ndarray:
    """(n, 3, 3) covariances of random axes, with sigmas from 1e-5 to 1e3: most of them are nearly singular."""
    axes = np.linalg.qr(RNG.normal(size=(count, 3, 3)))[0]
    variances = 10.0 ** RNG.uniform(-10.0, 6.0, size=(count, 3))
    covs = (axes * variances[:, None, :]) @ axes.transpose(0, 2, 1)
    return 0.5 * (covs + covs.transpose(0, 2, 1))


MILD = np.diag([0.04, 0.3, 0.02]) + 0.03 * np.ones((3, 3))


def test_a_root_of_the_information_is_the_inverse_of_the_factor_of_lapack() -> None:
    for cov in [MILD, *covariances_of_any_shape(300)]:
        try:
            factor = np.linalg.cholesky(cov)
        except np.linalg.LinAlgError:  # by rounding
            continue
        found = whitening(cov)
        assert np.allclose(found, np.tril(found))
        assert np.allclose(found @ factor, np.eye(3), rtol=0.0, atol=1e-15 * np.linalg.cond(factor) ** 2)
    assert np.allclose(inverse_covariance(MILD), np.linalg.inv(MILD), rtol=1e-13)


@pytest.mark.parametrize("entry", [(0, 0), (1, 1), (2, 2)])
def test_what_is_not_positive_definite_has_no_root(entry: tuple[int, int]) -> None:
    cov = MILD.copy()
    cov[entry] = -0.01
    with pytest.raises(ValueError, match="not positive definite"):
        whitening(cov)
