import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sixthsense.core.geometry import Pose, point_segment_distance, rotation, wrap_angle

coordinates = st.floats(-1e3, 1e3)
angles = st.floats(-50.0, 50.0)
poses = st.builds(Pose, coordinates, coordinates, angles)


def close(a: Pose, b: Pose, tolerance: float = 1e-9) -> bool:
    return math.dist(a.position, b.position) < tolerance and abs(wrap_angle(a.theta - b.theta)) < tolerance


@given(poses, poses, poses)
def test_poses_form_a_group(a, b, c):
    assert close((a @ b) @ c, a @ (b @ c), 1e-6)
    assert close(a @ a.inverse(), Pose(), 1e-6)
    assert close(a @ Pose(), a) and close(Pose() @ a, a)


@given(poses, poses)
def test_the_adjoint_of_a_product_is_the_product_of_adjoints(a, b):
    assert np.allclose((a @ b).adjoint(), a.adjoint() @ b.adjoint(), atol=1e-6)
    assert np.allclose(a.inverse().adjoint(), np.linalg.inv(a.adjoint()), atol=1e-6)


@given(poses, st.integers(0, 2))
def test_the_adjoint_moves_a_small_motion_to_the_other_side_of_a_pose(a, k):
    small = 1e-6 * np.eye(3)[k]
    conjugated = (a @ Pose.from_array(small)) @ a.inverse()  # exp(Ad small)
    assert np.allclose(conjugated.array(), a.adjoint() @ small, atol=1e-9)


@given(poses, poses, coordinates, coordinates)
def test_frames_cancel_for_points_as_for_poses(a, b, x, y):
    point = np.array([x, y])
    assert np.allclose((a @ b) @ point, a @ (b @ point), atol=1e-6)
    assert np.allclose(a @ point, a.position + rotation(a.theta) @ point)


def test_what_is_no_pose_and_no_point_is_refused():
    for call in (lambda: Pose.from_array([1.0, 2.0]), lambda: Pose([1.0, 2.0, 0.3]), lambda: Pose() @ np.zeros(3)):
        with pytest.raises(ValueError, match=r"expected shape|allowed: three numbers"):
            call()


def test_the_distance_to_a_segment_is_to_its_nearest_point():
    segments = np.array([[[0, 0], [2, 0]], [[0, 0], [0, 2]], [[1, 1], [1, 1]]], dtype=float)
    assert np.allclose(point_segment_distance(np.array([3.0, 1.0]), segments), [math.sqrt(2), 3.0, 2.0])
