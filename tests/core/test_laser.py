import math
from dataclasses import replace

import numpy as np
import pytest

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, Sweep, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.returns import NO_BEAM


def reference(pose, bearings, walls, max_range):
    """One ray and one wall at a time, by solving x + t d = a + u e."""
    out = np.full(len(bearings), np.inf)
    for i, angle in enumerate(bearings + pose.theta):
        d = np.array([math.cos(angle), math.sin(angle)])
        for a, b in walls:
            matrix = np.stack([d, a - b], axis=1)
            if abs(np.linalg.det(matrix)) > 1e-12:
                t, u = np.linalg.solve(matrix, a - pose.position)
                if t >= 0 and -1e-9 <= u <= 1 + 1e-9 and t < max_range:
                    out[i] = min(out[i], t)
    return out


def test_rays_agree_with_a_plain_reference():
    rng = np.random.default_rng(0)
    for _ in range(20):
        walls = rng.uniform(-6, 6, (12, 2, 2))
        pose = Pose(*rng.uniform(-4, 4, 2), rng.uniform(-3, 3))
        bearings = rng.uniform(-math.pi, math.pi, 40)
        found, expected = cast_rays(pose, bearings, walls, 5.0), reference(pose, bearings, walls, 5.0)
        assert np.array_equal(np.isinf(found), np.isinf(expected))
        assert np.allclose(found[np.isfinite(found)], expected[np.isfinite(found)], atol=1e-9, rtol=0)


def test_the_first_number_that_is_not_finite_is_named_with_its_place():
    walls = np.arange(12.0).reshape(3, 2, 2)
    walls[2, 0, 1] = walls[2, 1, 0] = np.nan
    with pytest.raises(ValueError, match=r"walls: expected finite numbers, got nan at \[2, 0, 1\]"):
        cast_rays(Pose(), np.array([0.3]), walls, 2.0)


def test_no_ray_leaks_through_the_joint_of_two_walls():
    rng = np.random.default_rng(1)
    for _ in range(200):
        corner = rng.uniform(1, 5, 2)
        walls = np.array([[corner, corner + rng.uniform(-3, 3, 2)], [corner, corner + rng.uniform(-3, 3, 2)]])
        bearing = math.atan2(corner[1], corner[0])
        assert cast_rays(Pose(), np.array([bearing]), walls, 20.0)[0] <= math.hypot(*corner) + 1e-6


def test_beyond_the_maximum_there_is_no_return():
    walls = np.array([[[3, -1], [3, 1]]], dtype=float)
    assert cast_rays(Pose(), np.array([0.0]), walls, 2.9)[0] == np.inf
    scan = Scan.from_config(np.array([1.0, 2.0, 10.0, 12.0, np.inf]), LaserConfig(beams=5, fov=1.0))
    assert scan.ranges.tolist() == [1.0, 2.0, np.inf, np.inf, np.inf]


def test_a_full_circle_is_closed_and_repeats_no_beam():
    full, half = LaserConfig(beams=360), LaserConfig(beams=181, fov=math.pi)
    scan = Scan.from_config(np.ones(360), full)
    assert scan.closed and scan.bearings[-1] < math.pi - 0.9 * float(scan.angle_increment)
    assert not Scan.from_config(np.ones(181), half).closed
    assert beam_bearings(half)[[0, -1]] == pytest.approx([-math.pi / 2, math.pi / 2])
    report = preset("report").laser
    assert math.degrees(beam_bearings(report)[1] - beam_bearings(report)[0]) == pytest.approx(2.0)


@pytest.mark.parametrize("increment", [0.1, -0.1])
def test_a_cell_has_its_nearest_return_whatever_the_order_of_beams_and_none_where_nothing_was_measured(increment):
    farthest = 5.6  # in single precision, which a driver may write where nothing was measured, below it
    ranges = np.array([2.0, np.inf, np.nan, 3.0, 4.0, 0.0, farthest], np.float32)
    scan = Scan(ranges, np.float32(-3.0 * increment), np.float32(increment), farthest)
    found = scan.by_bearing[:: int(np.sign(increment))]
    assert found[:, 2].tolist() == [2.0, 0.0, NO_BEAM, 3.0, 4.0, NO_BEAM, 0.0]
    assert found[[0, 3, 4], :2] == pytest.approx(scan.points_laser[[0, 3, 4]], abs=1e-6)
    bearings = np.array([-0.3, -0.26, -0.1, 0.0, 0.04, 0.3, 0.3])
    swept = replace(scan, sweep=Sweep(bearings, False, np.zeros((3, 3)), np.zeros(7)))
    assert swept.by_bearing[:, 2].tolist() == [2.0, NO_BEAM, NO_BEAM, 3.0, NO_BEAM, NO_BEAM, 0.0]
