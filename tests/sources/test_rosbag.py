import math
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sixthsense import cli
from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.sources.logs import open_log

ROOM = np.array([[[-3, -2], [4, -2]], [[4, -2], [4, 3]], [[4, 3], [-3, 3]], [[-3, 3], [-3, -2]]], dtype=np.float64)
MOUNT = Pose(0.2, -0.1, 0.4)
LASER = LaserConfig(beams=240, fov=math.radians(239.0), max_range=8.0)
KINDS = ["ros1", "mcap", "sqlite"]
S = 10**9  # nanoseconds
LASER_SCAN, ODOMETRY, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


class Bag:
    """A bag of somebody else's robot, as the library writes it."""

    def __init__(self, path: Path, kind: str) -> None:
        self.one = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.one else Stores.ROS2_JAZZY)
        if self.one:  # it does not know tf2
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.path = path.with_suffix(".bag") if self.one else path
        self.writer = Writer1(self.path) if self.one else Writer2(path, version=8, storage_plugin=plugin)
        self.topics: dict = {}

    def __enter__(self) -> "Bag":
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def make(self, name: str, *values):
        return self.store.types[name](*values)

    def header(self, stamp_ns: int, frame: str):
        time = self.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        return self.make("std_msgs/msg/Header", *((0,) if self.one else ()), time, frame)

    def write(self, topic: str, name: str, message, record_ns: int) -> None:
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, name, typestore=self.store)
        put = self.store.serialize_ros1 if self.one else self.store.serialize_cdr
        self.writer.write(self.topics[topic], record_ns, put(message, name))

    def pose(self, pose: Pose, turn=None):
        place = self.make("geometry_msgs/msg/Point", pose.x, pose.y, 0.0)
        turn = turn or (0.0, 0.0, math.sin(pose.theta / 2), math.cos(pose.theta / 2))
        return self.make("geometry_msgs/msg/Pose", place, self.make("geometry_msgs/msg/Quaternion", *turn))

    def odometry(self, topic: str, stamp_ns: int, pose: Pose, late_ns: int = 0, tilted=None) -> None:
        zero, cov = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0), np.zeros(36)
        spread = self.make("geometry_msgs/msg/PoseWithCovariance", self.pose(pose, tilted), cov)
        twist = self.make(
            "geometry_msgs/msg/TwistWithCovariance", self.make("geometry_msgs/msg/Twist", zero, zero), cov
        )
        message = self.make(ODOMETRY, self.header(stamp_ns, "odom"), "base_footprint", spread, twist)
        self.write(topic, ODOMETRY, message, stamp_ns + late_ns)

    def scan(
        self,
        topic: str,
        stamp_ns: int,
        ranges,
        late_ns: int = 0,
        first=None,
        step=None,
        low=0.1,
        high=8.0,
        frame="/laser_link",
        lag=0.0,
    ) -> None:
        first = -math.radians(119.5) if first is None else first
        step = math.radians(1.0) if step is None else step
        row = np.asarray(ranges, dtype=np.float32)
        last = first + step * (len(row) - 1)
        message = self.make(
            LASER_SCAN, self.header(stamp_ns, frame), first, last, step, lag, 0.1, low, high, row, row[:0]
        )
        self.write(topic, LASER_SCAN, message, stamp_ns + late_ns)

    def transform(self, parent: str, child: str, place: Pose, turn=None, up: float = 0.0, stamp_ns: int = -1) -> None:
        """A static transform, or with a stamp one of /tf."""
        turn = turn or (0.0, 0.0, math.sin(place.theta / 2), math.cos(place.theta / 2))
        shift = self.make("geometry_msgs/msg/Vector3", place.x, place.y, up)
        link = self.make("geometry_msgs/msg/Transform", shift, self.make("geometry_msgs/msg/Quaternion", *turn))
        stamped = self.make("geometry_msgs/msg/TransformStamped", self.header(max(stamp_ns, 0), parent), child, link)
        self.write("/tf_static" if stamp_ns < 0 else "/tf", TF, self.make(TF, [stamped]), max(stamp_ns, 0))


def way(seconds: float) -> Pose:
    return Pose(0.5 * math.sin(0.3 * seconds), 0.2 * seconds, 0.4 * seconds)


def ranges_at(seconds: float) -> np.ndarray:
    return cast_rays(way(seconds) @ MOUNT, beam_bearings(LASER), ROOM, LASER.max_range)


def foreign(path: Path, kind: str, late_ns: int = 0, duration_s: float = 4.0) -> Path:
    """A walk through the room: odometry at 50 Hz, scans at 8 Hz between, other names, a mount in two steps."""
    with Bag(path, kind) as bag:
        bag.transform("base_footprint", "base_link", Pose(), up=0.1)
        bag.transform("base_link", "laser_link", MOUNT, up=0.3)
        messages = [(k * 20_000_000, "odometry") for k in range(int(50 * duration_s))]
        messages += [(7_000_000 + k * 125_000_000, "scan") for k in range(int(8 * duration_s) - 1)]
        # Whoever records gets a scan late: it stands behind odometry that is younger.
        for stamp, what in sorted(messages, key=lambda m: m[0] + late_ns * (m[1] == "scan")):
            if what == "scan":
                bag.scan("/robot/front/scan", stamp + 10**9, ranges_at(stamp * 1e-9), late_ns)
            else:
                bag.odometry("/wheels", stamp + 10**9, way(stamp * 1e-9))
    return bag.path


def test_two_lasers_in_turn_on_one_topic_under_one_frame_are_told(tmp_path, capsys):
    back = MOUNT @ Pose(-0.5, 0.0, math.pi)
    with Bag(tmp_path / "two", "mcap") as bag:
        for k in range(80):
            seconds = 0.05 * k
            bag.odometry("/wheels", int(1e9 * seconds) + 10**9, way(seconds))
            place = way(seconds) @ (back if k % 2 else MOUNT)
            ranges = cast_rays(place, beam_bearings(LASER), ROOM, LASER.max_range)
            bag.scan("/scan", int(1e9 * seconds) + 10**9, ranges)
    assert cli.main(["replay", str(bag.path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert said.count("\n") == 0 and "found scans of two lasers in turn, all of frame laser_link" in said


@pytest.mark.parametrize("kind", KINDS)
def test_a_foreign_bag_gives_scans_odometry_and_the_mount(kind, tmp_path):
    log = open_log(foreign(tmp_path / "theirs", kind), LaserConfig())
    assert log.has_odometry and not log.backward_stamps
    assert len(log.scans) == 31 and log.start == way(0.0)
    mount = log.scans[0].T_robot_laser
    assert (mount.x, mount.y, mount.theta) == pytest.approx((MOUNT.x, MOUNT.y, MOUNT.theta))
    assert (log.laser.beams, log.laser.max_range, log.laser.mount) == (240, 8.0, (mount.x, mount.y, mount.theta))
    assert log.laser.fov == pytest.approx(math.radians(239.0), rel=1e-6)
    stamps = [tick.stamp_ns for tick in log.ticks]
    assert stamps == sorted(set(stamps))
    for tick in log.ticks:
        if tick.scan is not None:
            seconds = tick.stamp_ns * 1e-9 - 1.0
            assert tick.log_stamp_s == pytest.approx(seconds + 1.0)
            true = way(seconds)
            assert tick.odometry.array() == pytest.approx(true.array(), abs=1e-4)
            assert np.array_equal(tick.scan.ranges, ranges_at(seconds).astype(np.float32))


@pytest.mark.parametrize("kind", KINDS)
def test_the_command_replays_a_foreign_bag_and_then_its_own_folder(kind, tmp_path, capsys):
    file = foreign(tmp_path / "theirs", kind)
    assert cli.main(["replay", str(file), "--out", str(tmp_path / "out")]) == cli.DONE
    assert cli.main(["replay", str(tmp_path / "out"), "--out", str(tmp_path / "again")]) == cli.DONE
    first, second = ((tmp_path / name / "estimate.tum").read_bytes() for name in ("out", "again"))
    assert first == second
    table = np.loadtxt(tmp_path / "out" / "estimate.tum")
    assert len(table) == 31
    true = np.array([way(stamp - 1.0).position for stamp in table[:, 0]])  # the log's own stamps
    assert np.abs(table[:, 1:3] - true).max() < 0.02
    assert "Traceback" not in capsys.readouterr().err


def scan_of(tmp_path: Path, ranges, laser: LaserConfig | None = None, turn=None, **how) -> Scan:
    with Bag(tmp_path / "x", "mcap") as bag:
        if turn is not None:
            bag.transform("base_footprint", "laser_link", Pose(), turn)
        bag.odometry("/odom", 10**9, Pose())
        bag.scan("/scan", 10**9, ranges, **how)
    return open_log(bag.path, laser or LaserConfig()).scans[0]


def test_a_clockwise_scan_gives_the_same_points(tmp_path):
    scan = scan_of(tmp_path, [1.0, 2.0, 3.0], first=0.5, step=-0.25)
    assert scan.ranges.tolist() == [3.0, 2.0, 1.0] and scan.bearings.tolist() == [0.0, 0.25, 0.5]


@pytest.mark.parametrize("high", [np.inf, 3e38, 1e6])
def test_a_range_max_that_no_laser_has_is_replaced_by_what_the_ranges_say(high, tmp_path):
    scan = scan_of(tmp_path, [1.0, 7.5, np.inf, np.nan], high=high)
    assert scan.max_range == pytest.approx(7.5) and scan.max_range > 7.5
    assert scan.ranges.tolist() == [1.0, 7.5, np.inf, np.inf]
    with Bag(tmp_path / "y", "mcap") as bag:
        for k in range(20):
            bag.odometry("/odom", k * 10**9, Pose(0.1 * k, 0, 0))
            bag.scan("/scan", k * 10**9 + 1, [1.0, 2.0, *[65.53] * 6, 3.0 + 0.1 * k], high=high)
    log = open_log(bag.path)
    assert log.scans[5].ranges.tolist() == [1.0, 2.0, *[np.inf] * 6, 3.5]
    assert any(line.startswith("assumed: a laser of 65.39 m") for line in log.remarks())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_bag_that_is_cut_short_is_read_up_to_the_cut_or_refused_in_one_line(kind, share, tmp_path, complaint):
    path = foreign(tmp_path / "theirs", kind, duration_s=1.0)
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    if kind == "mcap" and share:
        log = open_log(path)
        assert 0.9 * share * 7 - 1 < len(log.scans) <= 7 and f"{file.name} is cut short" in log.remarks()[0]
    else:
        complaint("replay", path, "--out", tmp_path / "out")


# --- odometry from /tf, and none


def transformed(path, kind="mcap", links=(("odom", "base_link"),), mount=True, duration_s=2.0, at=way):
    """A bag of scans and of transforms from `links`, each moving along `way`."""
    with Bag(path, kind) as bag:
        if mount:
            bag.transform("base_link", "laser_link", MOUNT, up=0.3)
        for k in range(int(20 * duration_s)):
            t = 0.05 * k
            for parent, child in links:
                bag.transform(parent, child, at(t), stamp_ns=S + int(t * S))
            bag.scan("/scan", S + int(t * S), ranges_at(t))
    return bag.path


def poses(log):
    return np.array([tick.odometry.array() for tick in log.ticks if tick.scan is not None])


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_without_a_topic_of_odometry_it_is_the_moving_frame_that_leads_to_the_laser(kind, tmp_path):
    log = open_log(transformed(tmp_path / "x", kind), LaserConfig())
    assert poses(log) == pytest.approx(np.array([way(0.05 * k).array() for k in range(40)]), abs=1e-9)
    assert log.scans[0].T_robot_laser.array() == pytest.approx(MOUNT.array())
    assert any("odometry: /tf odom -> base_link" in line for line in log.remarks())


def test_a_named_pair_is_used_instead_of_the_topic_and_may_have_constant_links_between(tmp_path):
    with Bag(tmp_path / "x", "mcap") as bag:
        bag.transform("base_footprint", "base_link", Pose(0.1, 0, 0))
        bag.transform("base_link", "laser_link", MOUNT)
        for k in range(9):
            bag.odometry("/odom", S + k * S, Pose())
            bag.transform("odom", "base_footprint", Pose(0.2 * k, 0, 0), stamp_ns=S + k * S)
            bag.scan("/scan", S + k * S, np.ones(240))
    log = open_log(bag.path, LaserConfig(), odometry_frames=("odom", "/base_link"))
    assert poses(log)[:, 0] == pytest.approx(0.1 + 0.2 * np.arange(9))
    assert log.scans[0].T_robot_laser.array() == pytest.approx(MOUNT.array())
    assert not poses(open_log(bag.path, LaserConfig())).any()


def test_a_bag_with_scans_alone_has_no_odometry_and_the_frame_of_the_mount_is_the_robot(tmp_path):
    with Bag(tmp_path / "x", "mcap") as bag:
        bag.transform("base_link", "laser_link", MOUNT)
        for k in range(9):
            bag.scan("/scan", S + k * S, np.ones(240))
    log = open_log(bag.path, LaserConfig())
    assert not log.has_odometry and len(log.ticks) == 9
    assert log.scans[0].T_robot_laser.array() == pytest.approx(MOUNT.array())
    assert not open_log(foreign(tmp_path / "y", "mcap"), LaserConfig(), odometry=False).has_odometry


def test_a_bag_without_odometry_is_replayed_with_a_line_that_says_so(tmp_path, capsys):
    with Bag(tmp_path / "x", "mcap") as bag:
        for k in range(40):
            bag.scan("/scan", S + k * S // 10, ranges_at(0.1 * k))
    assert cli.main(["replay", str(bag.path), "--out", str(tmp_path / "out")]) == cli.DONE
    assert "no odometry is used" in capsys.readouterr().err
    assert "no_odometry = true" in (tmp_path / "out" / "config.toml").read_text()
    assert cli.main(["replay", str(tmp_path / "out"), "--out", str(tmp_path / "again")]) == cli.DONE
