"""What the formulae of the core give for general values: by hand, by quadrature, by finite differences."""

import math

import numpy as np
import pytest

from sixthsense.config import LaserConfig
from sixthsense.core.covariance import COVARIANCE_SLACK, check_covariance, covariance_fault
from sixthsense.core.geometry import Pose, interpolated, rotation, wrap_angle
from sixthsense.core.landmark_kernels import line_ends
from sixthsense.core.landmarks import Kind, Observation, line_point, observed_centre, polar_observation
from sixthsense.core.laser import Scan, sweep_ns, sweep_times
from sixthsense.core.motion import Odometry
from sixthsense.core.ray_casting import cast_rays, cast_sweep, near_walls
from sixthsense.core.sensor import Sensor


def test_a_polar_observation_is_the_point_that_explains_it_on_average():
    found = polar_observation(3.2, 0.7, (0.04, 0.09), floor_m=0.05)
    bearing, weights = np.polynomial.hermite_e.hermegauss(9)
    mean = weights @ np.column_stack([np.cos(0.7 + 0.3 * bearing), np.sin(0.7 + 0.3 * bearing)]) / weights.sum()
    assert mean * np.linalg.norm(found.z) == pytest.approx(3.2 * np.array([math.cos(0.7), math.sin(0.7)]))
    axes = rotation(0.7)
    expected = np.diag([0.04 + 0.05**2, (3.2 * 0.3) ** 2 + 0.05**2])
    assert axes.T @ found.cov @ axes == pytest.approx(expected, abs=1e-12)


def test_a_point_that_is_corrected_for_the_sensor_has_its_error_carried_along():
    sensor, cov = Sensor(0.12, 0.2), np.array([[0.09, 0.02], [0.02, 0.01]])
    z = np.array([1.4, 1.1])
    found = Observation(Kind.CORNER, z, cov).with_sensor(sensor)
    jacobian = np.column_stack([(sensor.corrected(z + h)[0] - sensor.corrected(z - h)[0]) / 2e-6
                                for h in 1e-6 * np.eye(2)])  # fmt: skip
    assert found.cov == pytest.approx(jacobian @ cov @ jacobian.T, rel=1e-6)
    assert np.array_equal(found.sensor.z, z) and np.array_equal(found.sensor.cov, cov)
    assert found.with_sensor(sensor) is found


def test_the_centre_and_the_ends_of_a_wall_lie_on_it():
    alpha, offset, lever = 2.2, 1.7, -0.8
    to_foot = np.array([[1.0, 0.0], [lever, 1.0]])
    wall = Observation(Kind.WALL, np.array([alpha, offset]), to_foot @ np.diag([0.02**2, 0.01**2]) @ to_foot.T)
    foot, along = offset * np.array([math.cos(alpha), math.sin(alpha)]), np.array([-math.sin(alpha), math.cos(alpha)])
    assert observed_centre(wall) == pytest.approx(foot + lever * along)
    assert line_point(wall.z, 1.3) == pytest.approx(foot + 1.3 * along)
    assert line_ends(wall.z, -0.6, 1.9) == pytest.approx(np.array([foot - 0.6 * along, foot + 1.9 * along]))


def test_a_motion_is_carried_if_its_position_is_known_to_a_quarter_of_a_metre_only():
    for k in (0, 1):
        sigmas = np.array([0.1, 0.1, 0.9])
        assert not Odometry(Pose(0.1, 0.2, 0.3), np.diag(sigmas) ** 2).is_carried()
        sigmas[k] = 0.26
        assert Odometry(Pose(0.1, 0.2, 0.3), np.diag(sigmas) ** 2).is_carried()


def test_a_pose_between_two_is_interpolated_along_the_shorter_arc():
    stamps, poses = np.array([1.0, 3.0, 7.0]), np.array([[0.5, 2.0, 3.0], [1.5, -2.0, -3.0], [2.0, 4.0, -2.0]])
    found = interpolated(stamps, poses, np.array([0.2, 1.5, 6.0, 9.0]))
    quarter = 3.0 + 0.25 * (2.0 * math.pi - 6.0)
    expected = np.array([[0.5, 2.0, 3.0], [0.75, 1.0, quarter], [1.875, 2.5, -2.25], [2.0, 4.0, -2.0]])
    assert found[:, :2] == pytest.approx(expected[:, :2])
    assert wrap_angle(found[:, 2] - expected[:, 2]) == pytest.approx(np.zeros(4), abs=1e-12)
    assert interpolated(stamps[1:2], poses[1:2], stamps).tolist() == [poses[1].tolist()] * 3


def test_matrices_that_are_no_covariances_are_told_from_those_that_are():
    good = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, 0.003], [0.002, 0.003, 0.01]])
    flat, negative, skew, unknown = (good.copy() for _ in range(4))
    flat[2], flat[:, 2], negative[2, 2], skew[0, 1], unknown[1, 1] = 0.0, 0.0, -0.001, 0.011, np.nan
    assert covariance_fault(flat, lowest=-1e-9) == ""
    for wrong in (negative, skew, unknown):
        assert covariance_fault(wrong, lowest=-1e-9)
    assert covariance_fault(good, lowest=0.0) == "" and covariance_fault(good, lowest=0.2)


def test_a_beam_of_a_sweep_is_cast_from_where_the_laser_is_then():
    rng = np.random.default_rng(6)
    walls, poses = rng.uniform(-6, 6, (9, 2, 2)), np.column_stack([rng.uniform(-2, 2, (60, 2)), rng.uniform(-3, 3, 60)])
    bearings = rng.uniform(-3, 3, 60)
    one_by_one = [cast_rays(Pose(*poses[k]), bearings[k : k + 1], walls, 4.0)[0] for k in range(60)]
    assert cast_sweep(poses, bearings, walls, 4.0) == pytest.approx(np.array(one_by_one), abs=1e-9)
    near = near_walls(walls, 3.0)
    for x, y, _ in poses:
        from_end = np.hypot(walls[..., 0] - x, walls[..., 1] - y).min(axis=1) < 3.0
        assert {tuple(wall) for wall in walls[from_end].reshape(-1, 4)} <= {tuple(wall) for wall in near(x, y)}


def test_beams_have_their_times_before_the_latest_and_their_points_in_the_frame_of_the_robot():
    assert sweep_times(4, np.float32(0.25)).tolist() == [-0.75, -0.5, -0.25, 0.0]
    assert sweep_times(4, np.float32(-0.25)).tolist() == [0.0, -0.25, -0.5, -0.75]
    assert sweep_ns(4, np.float32(-0.25)) == -750_000_000 and sweep_ns(4, np.float32(0.0)) == 0
    config = LaserConfig(beams=5, fov=2.0, max_range=9.0, mount=(0.2, -0.3, 0.5), sweep_s=0.1)
    scan = Scan.from_config(np.array([1.5, 2.5, 3.0, 2.0, 8.5]), config)
    expected = [[0.2 + r * math.cos(0.5 + b), -0.3 + r * math.sin(0.5 + b)]
                for r, b in zip(scan.ranges, (-1.0, -0.5, 0.0, 0.5, 1.0), strict=True)]  # fmt: skip
    assert scan.points_robot == pytest.approx(np.array(expected))
    assert scan.times_s == pytest.approx(np.array([-0.08, -0.06, -0.04, -0.02, 0.0]), abs=1e-8)


@pytest.mark.parametrize("kind", ["right", "indefinite", "asymmetric", "not finite"])
def test_a_covariance_is_allowed_by_its_pivots_as_by_its_eigenvalues(kind):
    rng = np.random.default_rng(7)
    for _ in range(100):
        root = rng.normal(size=(3, 3))
        cov = root @ root.T
        cov = 0.5 * (cov + cov.T)
        if kind == "indefinite":
            cov -= rng.uniform(1.01, 1.5) * np.linalg.eigvalsh(cov)[0] * np.eye(3)
        elif kind == "asymmetric":
            cov[tuple(rng.permutation(3)[:2])] += 1e-6 * cov.max()
        elif kind == "not finite":
            cov[tuple(rng.integers(3, size=2))] = rng.choice([np.nan, np.inf, -np.inf])
        assert (covariance_fault(cov, lowest=-COVARIANCE_SLACK) == "") == (kind == "right")
        if kind == "right":
            np.testing.assert_array_equal(check_covariance("odometry", cov), cov)
        else:
            with pytest.raises(ValueError, match=r"^odometry: found "):
                check_covariance("odometry", cov)
