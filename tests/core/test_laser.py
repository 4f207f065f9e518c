import math
import re

import numpy as np
import pytest

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import NearWalls, cast_among, cast_rays, hit_walls

WALL = np.array([[[2.0, -1.0], [2.0, 1.0]]])


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


def test_beams_in_any_order_hit_a_wall_on_which_the_laser_stands_or_at_whose_end():
    rng = np.random.default_rng(3)
    walls = rng.uniform(-4, 4, (8, 2, 2))
    for wall, share in ((0, 0.0), (1, 1.0), (2, 0.5), (3, 1e-4), (4, -1e-3), (5, 1.01)):
        at = walls[wall, 0] + share * (walls[wall, 1] - walls[wall, 0])
        for turn in (-np.pi, 0.0, 0.5 * np.pi, 2.0):
            bearings = rng.permutation(np.linspace(-np.pi, np.pi, 73))
            pose = Pose(at[0], at[1], turn)
            off = np.delete(walls, wall, axis=0)  # a beam from a wall hits it at 0, or not, by rounding
            found, expected = cast_rays(pose, bearings, off, 5.0), reference(pose, bearings, off, 5.0)
            assert np.allclose(found, expected, atol=1e-9, rtol=0)
            every = cast_rays(pose, bearings, walls, 5.0)
            assert (every <= found).all()


def test_near_walls_hold_all_that_is_in_reach_in_their_order():
    rng = np.random.default_rng(4)
    walls = rng.uniform(-60, 60, (400, 1, 2)) + rng.uniform(-2, 2, (400, 2, 2))
    near, bearings, place = NearWalls(walls, 8.0), np.linspace(-np.pi, np.pi, 90), np.zeros(2)
    for _ in range(200):
        place = np.clip(place + rng.uniform(-1.5, 1.5, 2), -50, 50)
        pose = Pose(place[0], place[1], 0.3)
        found = near.at(*place)
        assert np.array_equal(cast_among(pose, bearings, found, 8.0), cast_rays(pose, bearings, walls, 8.0))
        rows = [walls.reshape(-1, 4).tolist().index(wall) for wall in found.tolist()]
        assert rows == sorted(rows) and len(rows) < 100


def test_the_wall_that_a_beam_hits_is_the_only_one_at_its_range():
    rng = np.random.default_rng(2)
    for _ in range(20):
        walls = rng.uniform(-6, 6, (12, 2, 2))
        pose = Pose(*rng.uniform(-4, 4, 2), rng.uniform(-3, 3))
        bearings = rng.uniform(-math.pi, math.pi, 40)
        ranges, index = hit_walls(pose, bearings, walls, 5.0)
        expected = cast_rays(pose, bearings, walls, 5.0)
        assert np.array_equal(index < 0, np.isinf(expected))
        assert np.array_equal(np.isinf(ranges), np.isinf(expected))
        for i in np.flatnonzero(index >= 0):
            alone = cast_rays(pose, bearings[i : i + 1], walls[index[i]][None], 5.0)
            assert alone[0] == pytest.approx(expected[i], abs=1e-9)
            assert ranges[i] == pytest.approx(expected[i], abs=1e-9)


def test_without_walls_or_beams_nothing_is_hit():
    ranges, index = hit_walls(Pose(), np.zeros(2), np.zeros((0, 2, 2)), 5.0)
    assert np.isinf(ranges).all() and index.tolist() == [-1, -1]
    assert len(hit_walls(Pose(), np.zeros(0), np.ones((1, 2, 2)), 5.0)[1]) == 0


def test_rays_in_a_square_room_have_their_closed_form():
    walls = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[2, 2], [-2, 2]], [[-2, 2], [-2, -2]]], dtype=float)
    bearings = np.linspace(-math.pi, math.pi, 721)
    found = cast_rays(Pose(0.5, -0.25, 0.0), bearings, walls, 10.0)
    c, s = np.cos(bearings), np.sin(bearings)
    with np.errstate(divide="ignore"):
        to_x = np.where(c > 0, 1.5, 2.5) / np.abs(c)
        to_y = np.where(s > 0, 2.25, 1.75) / np.abs(s)
    assert np.allclose(found, np.minimum(to_x, to_y), atol=1e-9)


def test_no_ray_leaks_through_the_joint_of_two_walls():
    rng = np.random.default_rng(1)
    for _ in range(200):
        corner = rng.uniform(1, 5, 2)
        walls = np.array([[corner, corner + rng.uniform(-3, 3, 2)], [corner, corner + rng.uniform(-3, 3, 2)]])
        bearing = math.atan2(corner[1], corner[0])
        assert cast_rays(Pose(), np.array([bearing]), walls, 20.0)[0] <= math.hypot(*corner) + 1e-6


def test_a_ray_along_a_wall_and_a_wall_of_zero_length_cause_no_error():
    walls = np.array([[[1, 0], [2, 0]], [[3, -1], [3, 1]]], dtype=float)
    assert cast_rays(Pose(), np.array([0.0]), walls, 10.0)[0] == pytest.approx(3.0)


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


def test_a_scan_is_stored_in_float32_without_loss():
    scan = Scan.from_config(np.random.default_rng(2).uniform(0, 9, 360), LaserConfig())
    assert scan.ranges.dtype == np.float32 and not scan.ranges.flags.writeable
    again = float(np.float32(scan.angle_min)) + float(np.float32(scan.angle_increment)) * np.arange(360)
    assert np.array_equal(scan.bearings, again)


def test_the_mount_moves_the_points():
    config = LaserConfig(beams=2, fov=0.5, mount=(0.2, 0.1, math.pi / 2))
    scan = Scan.from_config(np.array([1.0, 1.0]), config)
    middle = scan.points_robot.mean(axis=0)
    assert middle == pytest.approx([0.2, 0.1 + math.cos(0.25)], abs=1e-6)


@pytest.mark.parametrize(
    ("bearings", "walls", "found"),
    [
        (np.zeros((2, 3)), WALL, r"bearings: expected shape (N,), got (2, 3)"),
        (0.5, WALL, r"bearings: expected shape (N,), got ()"),
        ([0.0, math.nan], WALL, r"bearings: expected finite numbers, got nan at [1]"),
        (["east"], WALL, r"bearings: expected numbers of shape (N,), got ['east']"),
        ([0.0], np.zeros((3, 4)), r"walls: expected shape (M, 2, 2), got (3, 4)"),
        ([0.0], [[[0, 1], [math.inf, 1]]], r"walls: expected finite numbers, got inf at [0, 1, 0]"),
    ],
)
def test_a_wrong_array_is_named_with_what_was_expected(bearings, walls, found):
    with pytest.raises(ValueError, match=re.escape(found)):
        cast_rays(Pose(), bearings, walls, 10.0)


def test_lists_are_arrays_and_a_laser_has_a_pose():
    assert cast_rays(Pose(), [0], [[[2, -1], [2, 1]]], 10.0) == pytest.approx([2.0])
    with pytest.raises(ValueError, match=re.escape("T_world_laser: expected a Pose(x, y, theta), got an array of sh")):
        cast_rays(np.zeros(3), [0.0], WALL, 10.0)
    with pytest.raises(ValueError, match="T_world_laser: expected finite numbers, got Pose"):
        cast_rays(Pose(math.nan), [0.0], WALL, 10.0)
