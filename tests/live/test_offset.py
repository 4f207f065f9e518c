"""The offset between the clocks of scans and odometry, found while messages come."""

import numpy as np
import pytest

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.live.offset import ClockOffset

BEARINGS = np.linspace(-np.pi, np.pi, 180, endpoint=False)
BEGAN_NS, TICK_NS = 1_700_000_000_000_000_000, 20_000_000


def ranges(pose: Pose) -> np.ndarray:
    """To the walls of a room of 7 by 5 m."""
    cos, sin = np.cos(pose.theta + BEARINGS), np.sin(pose.theta + BEARINGS)
    to_x = (np.where(cos > 0.0, 4.1, -2.9) - pose.x) / cos
    to_y = (np.where(sin > 0.0, 2.8, -2.2) - pose.y) / sin
    return np.minimum(to_x, to_y).astype(np.float32)


@pytest.mark.parametrize(
    ("lead_s", "turn_rate", "expected_s"), [(0.52, 1.0, 0.52), (0.02, 1.0, 0.0), (0.52, 0.0, None)]
)
def test_it_is_found_from_turns_in_pieces_and_not_without(lead_s, turn_rate, expected_s):
    offset, pose, changes = ClockOffset(0), Pose(0.3, -0.2, 0.4), []
    rng = np.random.default_rng(2)
    rates = np.concatenate([np.full(rng.integers(20, 120), rng.choice([-0.8, 0.0, 0.5, 1.1])) for _ in range(30)])
    for k, rate in enumerate((turn_rate * rates[:1500]).tolist()):
        pose = pose @ Pose(0.002, 0.0, 0.02 * rate)
        offset.add_odometry(BEGAN_NS + k * TICK_NS, pose.theta)
        if k % 5 == 0:
            scan = Scan(ranges(pose), np.float32(-np.pi), np.float32(2.0 * np.pi / 180), 10.0)
            if offset.add_scan(BEGAN_NS + k * TICK_NS + round(1e9 * lead_s), scan):
                changes.append(offset.lead_ns)
            if offset._look is not None:
                offset._look.join()
    assert [1e-9 * ns for ns in changes] == pytest.approx([expected_s] if expected_s else [], abs=0.03)
    assert offset._is_sure == (expected_s is not None)
