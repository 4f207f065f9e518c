"""Values without a special one for tests with hypothesis: no zero, no one, no heading of 0, no round stamp."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import Phase, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sixthsense.core.geometry import Pose

some = settings(max_examples=15, phases=(Phase.explicit, Phase.reuse, Phase.generate))
"""examples of slow tests, which are not made smaller"""


def numbers(low: float = 0.2, high: float = 30.0) -> st.SearchStrategy[float]:
    """Of either sign."""
    return st.builds(math.copysign, st.floats(low, high), st.sampled_from((-1.0, 1.0)))


poses = st.builds(Pose, numbers(), numbers(), numbers(0.1, 3.1))
stamps_ns = st.integers(1_000_000_001, (1 << 31) * 1_000_000_000 - 1)  # ROS counts seconds in 32 bits
triangles = st.tuples(*[numbers(0.2, 0.9)] * 6)
covariances = triangles.map(
    lambda v: (lower := np.array([[v[0], 0, 0], [v[1], v[2], 0], [v[3], v[4], v[5]]])) @ lower.T
)
tilts = st.tuples(numbers(0.02, 0.3), numbers(0.02, 0.3))
"""pitch and roll, radians"""


def turned(yaw: float, tilt: tuple[float, float], size: float = 1.0) -> list[float]:
    """A quaternion x y z w of a yaw, then pitch and roll; of another length than 1 with `size`."""
    return (size * Rotation.from_euler("ZYX", (yaw, *tilt)).as_quat()).tolist()


def matrix(x: float, y: float, z: float, quaternion: list[float]) -> np.ndarray:
    """(4, 4) of a transform."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), (x, y, z)
    return out
