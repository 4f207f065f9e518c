import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sixthsense.config import AssumedConfig, MotionNoise
from sixthsense.core.arcs import arc_jacobian
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.motion import Odometry, draw, odometry, rk4, variance
from sixthsense.core.wheels import PARAMETERS, Wheels, corrected_with_terms

QUIET = MotionNoise(speed=0, turn_rate=0, slip_position_per_sqrt_m=0, slip_position_per_sqrt_rad=0,
                    slip_heading_per_sqrt_m=0, slip_heading_per_sqrt_rad=0)  # fmt: skip


def exact_arc(v: float, w: float, t: float) -> Pose:
    if abs(w) < 1e-12:
        return Pose(v * t, 0.0, 0.0)
    return Pose(v / w * math.sin(w * t), 2 * v / w * math.sin(0.5 * w * t) ** 2, w * t)


@given(st.floats(-2, 2), st.floats(-3, 3), st.floats(0.01, 0.5))
def test_rk4_follows_the_circle(v, w, t):
    found, exact = rk4(Pose(), v, w, t, 0.01), exact_arc(v, w, t)
    assert math.dist(found.position, exact.position) < 1e-9
    assert abs(wrap_angle(found.theta - exact.theta)) < 1e-9


@pytest.mark.parametrize(("distance", "turn"), [(0.25, 0.026), (-0.4, 1.1), (0.3, 0.0), (0.0, 0.7), (1.0, 1e-6)])
def test_the_jacobian_of_an_arc_agrees_with_finite_differences(distance, turn):
    h, back = 1e-6, rk4(Pose(), distance, turn, 1.0, 1e-2).inverse()
    for column, (d, a) in enumerate(((h, 0.0), (0.0, h))):
        ahead, behind = (rk4(Pose(), distance + k * d, turn + k * a, 1.0, 1e-2) for k in (1, -1))
        off = (back @ ahead).array() - (back @ behind).array()
        np.testing.assert_allclose(arc_jacobian(distance, turn)[:, column], off / (2 * h), atol=1e-8)


@pytest.mark.parametrize("distribution", ["gaussian", "uniform"])
def test_drawn_noise_has_the_stated_variance(distribution):
    samples = draw(np.random.default_rng(2), distribution, 0.3, 200_000)
    assert samples.mean() == pytest.approx(0.0, abs=0.005)
    assert samples.var() == pytest.approx(variance(distribution, 0.3), rel=0.02)


@pytest.mark.parametrize("v, w", [(0.5, 0.0), (0.5, 0.8), (0.0, 1.0), (-0.3, -0.5)])
def test_the_covariance_of_an_increment_is_that_of_the_simulated_noise(v, w):
    assumed = AssumedConfig(floor_m=0.0, floor_rad=0.0, motion=MotionNoise(slip_position_per_sqrt_m=0.02))
    rng = np.random.default_rng(3)
    dt, noise = 0.1, assumed.motion
    expected = odometry(Pose(), rk4(Pose(), v, w, dt), assumed)
    d, a = abs(v * dt), abs(w * dt)
    sigma_p = math.sqrt(noise.slip_position_per_sqrt_m**2 * d + noise.slip_position_per_sqrt_rad**2 * a)
    sigma_h = math.sqrt(noise.slip_heading_per_sqrt_m**2 * d + noise.slip_heading_per_sqrt_rad**2 * a)
    samples = []
    for n1, n2, *slip in rng.normal(size=(20_000, 5)):
        end = rk4(Pose(), v * (1 + noise.speed * n1), w * (1 + noise.turn_rate * n2), dt)
        end = end @ Pose(sigma_p * slip[0], sigma_p * slip[1], sigma_h * slip[2])
        samples.append((expected.motion.inverse() @ end).array())
    found = np.cov(np.array(samples).T)
    scale = np.sqrt(np.outer(np.diag(expected.cov), np.diag(expected.cov)))
    assert np.abs((found - expected.cov) / scale).max() < 0.05


@pytest.mark.parametrize("motion", [Pose(0.01, 0, 0), Pose(0, 0, 0.02), Pose(0.01, 1e-4, 0.02)])
def test_every_moving_increment_has_full_rank_even_without_slip(motion):
    increment = odometry(Pose(), motion, AssumedConfig(motion=QUIET))
    assert np.linalg.eigvalsh(increment.cov)[0] > 0.0


def test_known_systematic_errors_are_corrected():
    assumed = AssumedConfig(wheel_scale_error=0.02, drift_rad_per_m=0.05)
    for v, w in ((0.5, 0.0), (0.5, 0.7), (0.0, 1.0), (-0.4, 0.2)):
        true_v = 1.02 * v
        true = exact_arc(true_v, 1.02 * w + 0.05 * true_v, 0.1)
        found = odometry(Pose(), exact_arc(v, w, 0.1), assumed).motion
        assert math.dist(found.position, true.position) < 1e-5
        assert found.theta == pytest.approx(true.theta, abs=1e-12)


def test_the_jacobian_by_the_wheels_agrees_with_finite_differences():
    rng = np.random.default_rng(4)
    for _ in range(30):
        reported, values = Pose(*rng.normal(size=3) * [0.3, 0.05, 0.4]), rng.normal(size=PARAMETERS) * 0.05
        motion, terms = corrected_with_terms(reported, Wheels.from_array(values))
        for k, step in enumerate(1e-6 * np.eye(PARAMETERS)):
            ahead, behind = (corrected_with_terms(reported, Wheels.from_array(values + s))[0] for s in (step, -step))
            off = (motion.inverse() @ ahead).array() - (motion.inverse() @ behind).array()
            assert np.allclose(off / 2e-6, terms.jacobian[:, k], atol=1e-7)


def test_composed_odometry_keeps_what_one_part_knows_of_the_wheels():
    plain = Odometry(Pose(0.2, 0.0, 0.3), 1e-4 * np.eye(3))
    motion, terms = corrected_with_terms(Pose(0.3, 0.0, 0.1), Wheels(0.01, 0.02))
    known = Odometry(motion, 1e-4 * np.eye(3), terms)
    for folded in (plain.then(known), known.then(plain)):
        assert folded.wheels is not None and folded.wheels.values == terms.values
    assert plain.then(plain).wheels is None
