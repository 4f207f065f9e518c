import numpy as np

from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import initialize_point, predict_points


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


def test_a_landmark_is_initialized_where_its_prediction_is_the_sighting():
    rng = np.random.default_rng(1)
    for _ in range(20):
        pose, z = Pose(*rng.normal(size=3)), rng.normal(size=2)
        mean, _, _ = initialize_point(pose, z)
        assert np.allclose(predict_points(pose, mean[None])[0][0], z)
