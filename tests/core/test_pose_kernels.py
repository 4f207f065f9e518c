"""The kernels of poses compute, bit for bit, what plain Python and `Pose` do."""

import math

import numpy as np

from sixthsense.core.geometry import Pose
from sixthsense.core.pose_kernels import Triple, composed, driven, inverted

RNG = np.random.default_rng(0)


def triple(pose: Pose) -> Triple:
    return pose.x, pose.y, pose.theta


def driven_in_python(pose: Pose, speed: float, turn_rate: float, step_s: float, steps: int) -> Pose:
    x, y, theta = triple(pose)
    for _ in range(steps):
        middle, end = theta + 0.5 * step_s * turn_rate, theta + step_s * turn_rate
        x += step_s / 6.0 * speed * (math.cos(theta) + 4.0 * math.cos(middle) + math.cos(end))
        y += step_s / 6.0 * speed * (math.sin(theta) + 4.0 * math.sin(middle) + math.sin(end))
        theta = end
    return Pose(x, y, theta)


def random_pose() -> Pose:
    return Pose(*RNG.uniform(-50.0, 50.0, 2), RNG.uniform(-4.0, 4.0))


def test_composed_is_the_product_of_poses() -> None:
    for _ in range(1000):
        a, b = random_pose(), random_pose()
        assert composed(triple(a), triple(b)) == triple(a @ b)


def test_driven_is_the_integration_in_plain_python() -> None:
    for _ in range(1000):
        pose, (speed, turn_rate), steps = random_pose(), RNG.uniform(-3.0, 3.0, 2), int(RNG.integers(1, 5))
        expected = driven_in_python(pose, speed, turn_rate, 0.01, steps)
        assert driven(triple(pose), float(speed), float(turn_rate), 0.01, steps) == triple(expected)


def test_inverted_is_the_inverse_of_a_pose() -> None:
    for _ in range(1000):
        pose = random_pose()
        assert inverted(triple(pose)) == triple(pose.inverse())
