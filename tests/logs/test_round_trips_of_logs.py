"""Files written by hand and read: general poses, frames, covariances, stamps to the nanosecond, maps with an origin."""

import math
import os
import tempfile
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from bags import KINDS, Bag
from general import covariances, matrix, numbers, poses, some, tilts, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

import sixthsense as ss
from sixthsense.config import AssumedConfig, LaserConfig, merge
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.logs import open_log
from sixthsense.logs.rosbag import read_poses
from sixthsense.record.exports import write_map
from sixthsense.simulation.scene import load_scene

S = 1_000_000_000
BEGAN = 1_700_000_000 * S
few = settings(some, max_examples=8)  # with files
steps_ns = st.lists(st.integers(20_000_001, 400_000_003), min_size=4, max_size=6)
small = st.builds(Pose, numbers(0.05, 0.3), numbers(0.05, 0.3), numbers(0.05, 0.3))


def written(name: str, text: str) -> Path:
    file = Path(tempfile.mkdtemp(dir=os.environ.get("PYTEST_TMP"))) / name
    file.write_text(text)
    return file


def seconds(ns: int) -> str:
    return f"{Decimal(ns) / S:.9f}"


def chain(start: Pose, step: Pose, count: int) -> list[Pose]:
    found = [start]
    for _ in range(count - 1):
        found.append(found[-1] @ step)
    return found


def line(*values: object) -> str:
    return " ".join(map(str, values)) + "\n"


def close(found: Pose, expected: Pose, to: float = 1e-9) -> None:
    assert found.position == pytest.approx(expected.position, abs=to)
    assert wrap_angle(found.theta - expected.theta) == pytest.approx(0.0, abs=to)


@few
@given(poses, small, st.builds(Pose, numbers(0.1, 0.9), numbers(0.1, 0.9), numbers(0.1, 3.0)), steps_ns)
def test_a_carmen_log_gives_odometry_mount_and_stamps(start, step, mount, steps):
    stamps, way, text = BEGAN + np.cumsum(steps), chain(start, step, len(steps)), ""
    for stamp, pose in zip(stamps.tolist(), way, strict=True):
        laser = pose @ mount
        places = (laser.x, laser.y, laser.theta, pose.x, pose.y, pose.theta)
        text += line("FLASER", 3, 2.5, 3.5, 4.5, *places, seconds(stamp), "host", 0.7)
    log = open_log(written("a.log", text), LaserConfig(max_range=4.0, fov=2.0))
    assert [tick.stamp_ns for tick in log.ticks] == stamps.tolist()
    assert [tick.log_stamp_s for tick in log.ticks] == [float(seconds(ns)) for ns in stamps.tolist()]
    for tick, pose in zip(log.ticks, way, strict=True):
        close(tick.odometry, pose)
        close(tick.scan.T_robot_laser, mount, 2e-6)
        assert tick.scan.ranges.tolist() == [2.5, 3.5, math.inf]
        assert tick.scan.bearings == pytest.approx([-1.0, 0.0, 1.0], abs=1e-6)
    assert log.laser.mount == pytest.approx(mount.array(), abs=2e-6) or abs(log.laser.mount[2] - mount.theta) > 6.0


@few
@given(st.sampled_from(KINDS), poses, small, poses, tilts, st.booleans(), steps_ns)
def test_a_bag_gives_the_odometry_at_each_sweeps_end_and_the_mount_of_tilted_frames(
    kind, start, step, mount, tilted, is_upside_down, steps
):
    plate = matrix(0.3, -0.4, 0.5, turned(0.7, tilted))
    level = matrix(mount.x, mount.y, 0.6, turned(mount.theta, (0.0, math.pi if is_upside_down else 0.0)))
    stamps, way = (BEGAN + np.cumsum(steps)).tolist(), chain(start, step, len(steps))
    sweep_ns, first = 10_000_000, -0.7
    ranges = np.array([2.5, 8.0, 0.05, 3.5, 0.9], np.float32)  # the limits are 0.1 and 8
    with Bag(Path(tempfile.mkdtemp()) / "x", kind) as bag:
        for parent, child, T in (("base_footprint", "plate", plate), ("plate", "laser", np.linalg.inv(plate) @ level)):
            turn = tuple(Rotation.from_matrix(T[:3, :3]).as_quat())
            bag.transform(parent, child, Pose(*T[:2, 3]), turn, up=float(T[2, 3]))
        for k, (stamp, pose) in enumerate(zip(stamps, way, strict=True)):
            bag.odometry(stamp, pose, "/wheels", turn=turned(pose.theta, tilted))
            if k + 1 < len(way):
                bag.scan(stamp, ranges, first=first, step=0.3, lag=sweep_ns / 4e9, low=0.1, record_ns=stamp + 7)
    found = read_poses(bag.path, "/wheels")
    assert found.stamps_ns.tolist() == stamps
    expected = [[pose.x, pose.y, 0.0, *turned(pose.theta, tilted)] for pose in way]
    assert found.poses.tolist() == expected and found.covs.shape == (len(way), 6, 6)
    log = open_log(bag.path, LaserConfig())
    scans = [tick for tick in log.ticks if tick.scan is not None]
    assert len(scans) == len(way) - 1
    side = -1.0 if is_upside_down else 1.0
    bearings, kept = first + 0.3 * np.arange(5), np.array([True, False, False, True, True])
    points_laser = (ranges[:, None] * np.stack([np.cos(bearings), side * np.sin(bearings)], axis=1))[kept]
    for k, tick in enumerate(scans):
        share = sweep_ns / (stamps[k + 1] - stamps[k])
        expected = Pose(*(way[k].position + share * (way[k + 1].position - way[k].position)))
        assert tick.stamp_ns == pytest.approx(stamps[k] + sweep_ns, abs=2) and tick.log_stamp_s == stamps[k] / 1e9
        close(tick.odometry, Pose(expected.x, expected.y, way[k].theta + share * step.theta), 1e-7)
        points = tick.scan.points_robot[::-1] if is_upside_down else tick.scan.points_robot
        np.testing.assert_allclose(points[kept], mount @ points_laser, atol=1e-5)
        assert np.isinf(tick.scan.ranges).sum() == 2
        times = tick.scan.times_s[::-1] if is_upside_down else tick.scan.times_s
        assert times == pytest.approx(1e-9 * sweep_ns * (np.arange(5) / 4.0 - 1.0))
    assert log.laser.mount == pytest.approx(tuple(mount.array()))
    given_mount = open_log(bag.path, LaserConfig(mount=(0.3, 0.4, -0.5)))
    assert given_mount.scans[0].T_robot_laser == Pose(0.3, 0.4, -0.5)


@few
@given(poses, poses, tilts, poses)
def test_odometry_in_tf_is_the_pair_that_is_named_or_the_only_one_that_moves_the_laser(world, moving, tilted, mount):
    """Beside the wheels' own transform another one moves that a map corrects, and one of another robot."""
    turn = turned(moving.theta, tilted)
    with Bag(Path(tempfile.mkdtemp()) / "x") as bag:
        bag.transform("base", "laser", mount)
        for k in range(3):
            ahead = Pose(moving.x + 0.1 * k, moving.y)
            bag.transform("odom", "base", ahead, turn, stamp_ns=BEGAN + k * S // 10)
            bag.transform("map", "odom", Pose(world.x, world.y + 0.3 * k), stamp_ns=BEGAN + k * S // 10)
            bag.transform("odom", "other", Pose(k), stamp_ns=BEGAN + k * S // 10)
            bag.scan(BEGAN + k * S // 10, [2.5, 3.5, 4.5])
    (x, y), yaw = moving.position, Rotation.from_quat(turn).as_matrix()
    for frames in ((), ("odom", "base")):
        log = open_log(bag.path, LaserConfig(), odometry_frames=frames)
        close(log.ticks[0].odometry, Pose(x, y, math.atan2(yaw[1, 0], yaw[0, 0])))
        close(log.ticks[-1].odometry, Pose(x + 0.2, y, math.atan2(yaw[1, 0], yaw[0, 0])))
        close(log.scans[0].T_robot_laser, mount)
    log = open_log(bag.path, LaserConfig(), odometry_frames=("map", "odom"))
    assert log.ticks[-1].odometry.position == pytest.approx((world.x, world.y + 0.6))


def test_odometry_in_tf_that_is_not_clear_is_asked(tmp_path):
    with Bag(tmp_path / "x") as bag:
        for k in range(3):
            for robot in ("a", "b"):
                bag.transform("odom", robot, Pose(0.1 * k), stamp_ns=BEGAN + k * S // 10)
            bag.scan(BEGAN + k * S // 10, [2.5, 3.5, 4.5])
    with pytest.raises(InputError, match=r"found odom -> a and odom -> b, allowed: .* `odometry_frames` PARENT,CHILD"):
        open_log(bag.path)
    with pytest.raises(InputError, match=r"found odom -> c, .*: odom -> a, odom -> b"):
        open_log(bag.path, odometry_frames=("odom", "c"))


@few
@given(st.lists(poses, min_size=2, max_size=4), covariances, poses, st.sampled_from(["EDGE_SE2", "ODOMETRY"]))
def test_a_graph_gives_the_product_of_its_edges_and_their_covariances(steps, cov, place, tag):
    numbers_of = cov if tag == "ODOMETRY" else np.linalg.inv(cov)
    order = list(zip(*np.triu_indices(3), strict=True))
    text = "".join(
        line(tag, k + 3, k + 4, *map(repr, step.array().tolist()), *(repr(float(numbers_of[ij])) for ij in order))
        for k, step in enumerate(steps)
    )
    bearing, distance = math.atan2(place.y, place.x), math.hypot(place.x, place.y)
    text += line("BR", 4, 77, bearing, distance, 0.02, 0.3)
    for name, matrix_of in (("LANDMARK", cov[:2, :2]), ("EDGE_SE2_XY", np.linalg.inv(cov[:2, :2]))):
        upper = [repr(float(matrix_of[ij])) for ij in ((0, 0), (0, 1), (1, 1))]
        text += line(name, 4, 78 + (name != "LANDMARK"), place.x, place.y, *upper)
    ticks, pose = open_log(written("a.g2o", text)).ticks, Pose()
    for tick, step in zip(ticks[1:], steps, strict=True):
        pose = pose @ step
        close(tick.odometry, pose, 1e-8)
        assert tick.increment_cov == pytest.approx(cov, rel=1e-6, abs=1e-6)
    for seen in (ticks[1].observations[78], ticks[1].observations[79]):
        assert np.array_equal(seen.z, place.position) and seen.cov == pytest.approx(cov[:2, :2], rel=1e-6)
    b, r, polar = ticks[1].observations[77].bearing_range()
    assert (b, r) == (pytest.approx(bearing, abs=2e-3), pytest.approx(distance, rel=2e-3))
    assert np.diag(polar) == pytest.approx([0.02**2, 0.3**2], rel=0.05)


@given(poses, numbers(0.2, 1.2), st.floats(2.0, 9.0))
@few
def test_a_mrclam_folder_gives_the_way_the_truth_and_landmarks_by_depth_bearing_and_their_noise(start, bearing, depth):
    folder = written("Barcodes.dat", "3 13\n8 25\n9 31\n").parent
    times = [f"{1000 + 0.25 * k:.3f}" for k in range(5)]
    (folder / "Robot3_Odometry.dat").write_text("".join(line(t, 0.4, 0.3) for t in times))
    theta = [start.theta, start.theta + 0.3]  # may cross pi
    ends = (("999.9", start.x, start.y, theta[0]), ("1001.1", start.x + 0.4, start.y - 0.7, wrap_angle(theta[1])))
    (folder / "Robot3_Groundtruth.dat").write_text("".join(line(*end) for end in ends))
    seen = [(13, 2.5, 0.3), (25, depth, bearing)]
    (folder / "Robot3_Measurement.dat").write_text("".join(line("1000.600", *row) for row in seen))
    noise = {"laser": {"range_m": 0.2, "bearing_rad": 0.03}, "landmark_floor_m": 0.05}
    ticks = open_log(folder, assumed=merge(AssumedConfig(), noise)).ticks
    stamps = [k * S // 20 for k in (4, 9, 12, 14, 19)]  # commands show 0.2 s later
    assert [tick.stamp_ns - 1000 * S for tick in ticks] == stamps
    for tick in ticks:
        s = 1e-9 * (tick.stamp_ns - 1000 * S)
        share = (s + 0.1) / 1.2
        close(tick.truth, Pose(start.x + 0.4 * share, start.y - 0.7 * share, start.theta + 0.3 * share), 1e-6)
        turn = 0.3 * (s - 0.2)
        arc = Pose(0.4 / 0.3 * math.sin(turn), 0.4 / 0.3 * (1.0 - math.cos(turn)), turn)
        close(tick.odometry, ticks[0].truth @ arc, 1e-6)
    ((subject, found),) = ticks[2].observations.items()
    assert subject == 8 and not any(tick.observations for tick in ticks if tick is not ticks[2])
    b, r, polar = found.bearing_range()
    distance = depth / math.cos(bearing)
    assert (b, r) == (pytest.approx(bearing, abs=0.01), pytest.approx(distance, rel=0.01))
    floor = 0.05**2
    expected = [0.03**2 + floor / distance**2, 0.2**2 + floor]
    assert np.diag(polar) == pytest.approx(expected, rel=0.03)


def test_edges_to_earlier_poses_are_loop_closures_either_way_and_stay_in_the_run_folder(tmp_path):
    """A round of 12 poses whose odometry is turned too far; closures with the first poses, one of them reversed."""
    step, wrong = Pose(0.8, 0.1, 2.0 * math.pi / 12), Pose(0.8, 0.1, 2.0 * math.pi / 12 + 0.02)
    true = chain(Pose(), step, 13)
    text = "".join(line("EDGE_SE2", k, k + 1, *wrong.array().tolist(), "1e3 0 0 1e3 0 1e3") for k in range(12))
    for i, j in ((11, 1), (0, 12), (12, 2)):
        text += line("EDGE_SE2", i, j, *(true[i].inverse() @ true[j]).array().tolist(), "2e3 3e2 0 4e3 0 9e3")
    log = open_log(file := written("round.g2o", text))
    assert [len(tick.closures) for tick in log.ticks] == [0] * 11 + [1, 2]
    (one,), (other, _) = log.ticks[11].closures, log.ticks[12].closures
    assert one.motion.array() == pytest.approx((true[1].inverse() @ true[11]).array())
    assert (one.before, other.before) == (1, 0)
    run = ss.replay(file, progress=False, out=tmp_path / "out", estimator="isam2")
    off = [np.hypot(*(pose[:2] - at.position)) for pose, at in zip(run.trace.trajectory, true, strict=True)]
    alone = [np.hypot(*(tick.odometry.position - at.position)) for tick, at in zip(log.ticks, true, strict=True)]
    assert max(alone) > 0.3 and max(off) < 0.1 * max(alone)
    again = ss.replay(tmp_path / "out", progress=False)
    assert again.trace.trajectory == pytest.approx(run.trace.trajectory, abs=1e-12)


def test_the_covariance_of_a_reversed_edge_is_that_of_its_samples():
    """Draws of the edge's error, in the axes of its end, as errors of the motion the other way in those of its end."""
    rng, cov = np.random.default_rng(4), np.array([[4.0, 1.0, 0.3], [1.0, 2.0, -0.4], [0.3, -0.4, 1.0]]) * 1e-4
    step, upper = Pose(1.7, -0.6, 0.8), " ".join(map(repr, np.linalg.inv(cov)[np.triu_indices(3)].tolist()))
    text = "".join("ODOMETRY {} {} 1 0.1 0.2 1e-4 0 0 1e-4 0 1e-4\n".format(*ends) for ends in ((0, 1), (1, 2)))
    text += f"EDGE_SE2 2 0 {' '.join(map(repr, step.array().tolist()))} {upper}\n"
    closure = open_log(written("back.g2o", text)).ticks[2].closures[0]
    draws = rng.multivariate_normal(np.zeros(3), cov, 20000)
    back = np.array([(step @ (step @ Pose(*draw)).inverse()).array() for draw in draws])  # beyond the motion back
    assert np.abs(closure.cov - np.cov(back.T)).max() < 0.05 * np.abs(closure.cov).max()


# --- maps


@few
@given(poses, st.integers(1, 4), st.integers(1, 6), st.floats(0.05, 0.4), st.booleans())
def test_a_map_is_a_scene_with_its_origin_yaw_resolution_and_shape(origin, row, col, cell_m, negate):
    pixels = np.full((11, 17), 254, np.uint8)
    pixels[row : row + 4, col : col + 7] = 0
    file = written("m.yaml", f"image: m.pgm\nresolution: {cell_m}\norigin: {origin.array().tolist()}\n"
        f"negate: {int(negate)}\noccupied_thresh: 0.65\nfree_thresh: 0.25\n")  # fmt: skip
    Image.fromarray(255 - pixels if negate else pixels).save(file.parent / "m.pgm")
    walls = load_scene(file).walls
    corners = np.array([(x, y) for x in (col, col + 7) for y in (7 - row, 11 - row)], dtype=float)
    expected = origin @ (cell_m * corners)
    found = np.unique(walls.reshape(-1, 2).round(6), axis=0)
    assert np.sort(found, axis=0) == pytest.approx(np.sort(np.unique(expected.round(6), axis=0), axis=0), abs=2e-6)
    along, to_centre = walls[:, 1] - walls[:, 0], expected.mean(axis=0) - walls[:, 0]  # the solid is on the left
    assert (along[:, 0] * to_centre[:, 1] - along[:, 1] * to_centre[:, 0] > 0.0).all()


def test_a_map_that_a_run_writes_is_a_scene_at_the_same_place(tmp_path):
    cells = np.full((9, 14), -1, dtype=np.int8)
    cells[2:8, 3:12], cells[3:5, 4:9] = 0, 100
    write_map(tmp_path, cells, (-1.5, 2.5), 0.15)
    ends = load_scene(tmp_path / "map.yaml", "free").walls.reshape(-1, 2).round(6)
    expected = np.array([-1.5, 2.5]) + 0.15 * np.array([(x, y) for x in (4, 9) for y in (3, 5)])
    assert {*map(tuple, ends.tolist())} == {*map(tuple, expected.round(6).tolist())}
