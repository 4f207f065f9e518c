import numpy as np
import pytest

from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import initialize_point, innovations, observation_innovations, predict_points


def test_jacobians_agree_with_finite_differences():
    rng = np.random.default_rng(0)
    for _ in range(50):
        pose, points = Pose(*rng.normal(size=3) * 3), rng.normal(size=(4, 2)) * 5
        z, by_pose, by_landmark = predict_points(pose, points)
        for k in range(3):
            ahead, _, _ = predict_points(Pose.from_array(pose.array() + 1e-6 * np.eye(3)[k]), points)
            assert np.allclose((ahead - z) / 1e-6, by_pose[:, :, k], atol=1e-4)
        for k in range(2):
            ahead, _, _ = predict_points(pose, points + 1e-6 * np.eye(2)[k])
            assert np.allclose((ahead - z) / 1e-6, np.tile(by_landmark[:, k], (4, 1)), atol=1e-4)
        mean, by_pose, by_z = initialize_point(pose, z[0])
        for k in range(3):
            ahead = initialize_point(Pose.from_array(pose.array() + 1e-6 * np.eye(3)[k]), z[0])[0]
            assert np.allclose((ahead - mean) / 1e-6, by_pose[:, k], atol=1e-4)
        for k in range(2):
            ahead = initialize_point(pose, z[0] + 1e-6 * np.eye(2)[k])[0]
            assert np.allclose((ahead - mean) / 1e-6, by_z[:, k], atol=1e-4)


def test_a_landmark_is_initialized_where_its_prediction_is_the_observation():
    rng = np.random.default_rng(1)
    for _ in range(20):
        pose, z = Pose(*rng.normal(size=3)), rng.normal(size=2)
        mean, _, _ = initialize_point(pose, z)
        assert np.allclose(predict_points(pose, mean[None])[0][0], z)


def test_a_line_that_turns_about_the_centre_of_its_returns_has_no_gap_there():
    """Whatever the turn: the offset from the robot shrinks by its cosine, and that is no error of the wall's place."""
    place, turn = np.array([1.5, 4.0]), 0.3
    lines, levers = [], []
    for alpha in (1.0, 1.0 + turn):
        normal, along = np.array([np.cos(alpha), np.sin(alpha)]), np.array([-np.sin(alpha), np.cos(alpha)])
        lines.append(np.array([alpha, normal @ place]))
        levers.append(along @ place)
    to_foot = np.array([[1.0, 0.0], [levers[1], 1.0]])
    cov = to_foot @ np.diag([0.1**2, 0.01**2]) @ to_foot.T
    (values,), (about,) = observation_innovations(lines[1][None], cov[None], lines[0][None], np.ones(1, bool))
    assert values[0] == pytest.approx(turn)
    # All of it is explained by the direction's sigma.
    assert values @ np.linalg.solve(about, values) == pytest.approx((turn / 0.1) ** 2)
    plain = innovations(lines[1], lines[0], np.array(True))
    assert plain @ np.linalg.solve(cov, plain) > 100.0


def test_innovations_about_the_centre_are_the_plain_ones_to_first_order():
    rng = np.random.default_rng(4)
    walls = np.array([True, False, True])
    predicted = rng.normal(size=(3, 2))
    root = rng.normal(size=(3, 2, 2))
    cov = root @ root.transpose(0, 2, 1)
    for small in (1e-3, 1e-5):
        z = predicted + small * rng.normal(size=(3, 2))
        values, about = observation_innovations(z, cov, predicted, walls)
        plain = innovations(z, predicted, walls)
        assert np.abs(values - plain).max() < 100.0 * small**2
        assert np.abs(about - cov).max() < 100.0 * small
        assert np.array_equal(values[1], plain[1]) and np.array_equal(about[1], cov[1])
