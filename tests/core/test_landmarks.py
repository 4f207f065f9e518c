import numpy as np
import pytest

from sixthsense.core.geometry import Pose
from sixthsense.core.landmark_kernels import innovations_of, predictions, translations
from sixthsense.core.landmarks import Kind, Observation, initialize_landmark, innovations, predict


def differences(function, at, step=1e-6):
    """(n, k) derivatives of a function's value (n,) by its argument (k,)."""
    steps = step * np.eye(len(at))
    return np.column_stack([(function(at + h) - function(at - h)) / (2.0 * step) for h in steps])


@pytest.mark.parametrize("kind", [Kind.CORNER, Kind.WALL])
@pytest.mark.parametrize("seed", range(20))
def test_jacobians_agree_with_finite_differences(kind, seed):
    rng, is_wall = np.random.default_rng(seed), np.array([kind == Kind.WALL])
    pose, landmark, by, cov = Pose(*rng.normal(size=3)), rng.normal(size=2), rng.normal(size=(1, 2)), np.eye(2)

    def seen(x, landmark):
        return predictions(tuple(x), landmark[None], is_wall)[0][0]

    def initialized(x, z):
        return initialize_landmark(Pose(*x), Observation(kind, z, cov))[0]

    def shifted(landmark):
        return translations(landmark[None], is_wall, by)[0][0]

    (z,), (by_pose,), (by_landmark,) = predictions(pose.triple(), landmark[None], is_wall)
    assert np.allclose(by_pose, differences(lambda x: seen(x, landmark), pose.array()), atol=1e-8)
    assert np.allclose(by_landmark, differences(lambda x: seen(pose.array(), x), landmark), atol=1e-8)
    mean, by_pose, by_z = initialize_landmark(pose, Observation(kind, z, cov))
    assert np.allclose(mean, landmark, atol=1e-12)  # where its prediction is the observation
    assert np.allclose(by_pose, differences(lambda x: initialized(x, z), pose.array()), atol=1e-8)
    assert np.allclose(by_z, differences(lambda z: initialized(pose.array(), z), z), atol=1e-8)
    assert np.allclose(translations(landmark[None], is_wall, by)[1][0], differences(shifted, landmark), atol=1e-8)


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
    (values,), (about,) = innovations_of(lines[1][None], cov[None], lines[0][None], np.ones(1, bool))
    assert values[0] == pytest.approx(turn)
    # All of it is explained by the direction's sigma.
    assert values @ np.linalg.solve(about, values) == pytest.approx((turn / 0.1) ** 2)


def test_what_estimators_outside_the_package_use_is_the_kernels_model() -> None:
    rng = np.random.default_rng(8)
    pose, landmarks, walls = Pose(0.7, -1.3, 2.4), rng.normal(0.0, 4.0, (6, 2)), rng.random(6) < 0.5
    for one, two in zip(predict(pose, landmarks, walls), predictions(pose.triple(), landmarks, walls), strict=True):
        assert np.array_equal(one, two)
    z, predicted = np.array([[3.1, 0.4], [3.1, 0.4]]), np.array([[-3.0, 0.1], [-3.0, 0.1]])
    expected = [[6.1 - 2.0 * np.pi, 0.3], [6.1, 0.3]]
    assert np.allclose(innovations(z, predicted, np.array([True, False])), expected)
