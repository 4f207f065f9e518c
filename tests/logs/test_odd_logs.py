"""Logs as people have them: what is odd costs itself, or is set right, and a note says so."""

import math
import shutil

import numpy as np
import pytest
from bags import KINDS
from robot_bag import MOUNT, T0_NS, changed, off_walls_m, read, robot_bag, way

import sixthsense as ss
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.logs import open_log

TF = (("tf", "base_footprint", "base_link", Pose()), ("tf", "base_link", "laser", MOUNT))
NAN = np.full(240, np.nan)


FIRST, ONE = range(3), range(40, 41)


def lidar(n, says):
    count = 1073 if n < 4 else 719
    return {**says, "first": -math.pi, "step": 2.0 * math.pi / count, "count": count, "high": 9.0}


def interlaced(n, says):
    first = math.radians(0.25 * (0, 1, 3, 2)[n % 4] - 90.0)
    return {**says, "first": first, "step": math.radians(1.0), "count": 181 - (n % 4 > 0)}


# name: keywords of the bag, number of scans, kinds of what is said
READ = {
    "base": ({"kind": "ros1"}, 60, ()),
    "1073 then 719 beams": ({"scan": lidar}, 60, ()),
    "interlaced": ({"scan": interlaced}, 60, ()),
    "clockwise": ({"scan": lambda n, says: {**says, "first": 2.0, "step": -says["step"]}}, 60, ()),
    "another frame first": ({"scan": changed("frame", "base_scan", FIRST)}, 57, ("left_out",)),
    "mount in /tf": ({"links": TF}, 60, ()),
    "odometry and mount in /tf": ({"links": TF, "odom_in_tf": True}, 60, ("odometry_frames",)),
    "no child frame": ({"odom": changed("child", "")}, 60, ("assumed_mount",)),
    "zero quaternion": ({"odom": changed("turn", (0.0, 0.0, 0.0, 0.0), FIRST)}, 60, ("left_out",)),
    "one range": ({"scan": changed("count", 1, ONE)}, 59, ("left_out",)),
    "all NaN": ({"scan": changed("ranges", NAN, ONE)}, 60, ()),
    "range_max 0": ({"scan": changed("high", 0.0)}, 60, ("assumed_range",)),
    "scans 37 s ahead": ({"late_s": 37.0}, 60, ("clocks",)),
    "scans 0.24 s behind": ({"late_s": -0.24}, 60, ("clocks",)),
    "no stamps": ({"scan": changed("stamp_ns", 0)}, 60, ("stamps_of_recording",)),
    "one stamp": ({"scan": changed("stamp_ns", T0_NS)}, 60, ("stamps_of_recording", "stamps")),
    "echoes": ({"echo": True}, 60, ()),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_an_odd_bag_has_its_returns_on_the_walls_and_says_what_is_odd(name, tmp_path):
    how, count, kinds = READ[name]
    log, found = read(robot_bag(tmp_path / "bag", **how))
    assert len(log.scans) == count and log.scans[0].T_robot_laser.array() == pytest.approx(MOUNT.array(), abs=1e-6)
    ahead_s = how.get("late_s", 0.0)
    assert off_walls_m(log.ticks, ahead_s) < 1e-4
    assert found.keys() == set(kinds)
    if ahead_s:
        assert found["clocks"].value == pytest.approx(ahead_s, abs=0.02)
        own_s = {1e-9 * (tick.stamp_ns - T0_NS) - ahead_s: tick.odometry for tick in log.ticks if tick.scan}
        turned = [(way(s).inverse() @ odometry).theta for s, odometry in own_s.items() if 0.0 < s < 5.9]
        assert np.abs(turned).max() < 0.03


# name: keywords of the bag, what is said
REFUSED = {
    "degrees": ({"scan": changed("angle_unit", 180.0 / math.pi)}, "degrees, allowed: radians"),
    "increment of twice": (
        {"scan": lambda n, says: {**says, "first": -3.0, "step": 0.05, "last": 3.0}}, "spans 1.99 times"),
    "millimetres": ({"scan": changed("unit", 1000.0)}, "mm"),
    "odometry in mm": ({"odom": changed("unit", 1000.0)}, "which are mm or cm, allowed: metres"),
    "two topics": ({"scan": changed("topic", "/rear", range(1, 99, 2))}, "allowed: one, by `topics` /rear or /scan"),
    "no scans": ({"scan": lambda n, says: None}, "but /odom (Odometry)"),
    "no return": ({"scan": changed("ranges", NAN)}, "found no return in 60 scans"),
    "no scan of any use": ({"scan": changed("count", 1)}, "found a scan of 1 ranges, allowed: 2 to"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_bag_that_cannot_be_right_is_refused_in_one_line_that_names_the_option(name, tmp_path):
    how, said = REFUSED[name]
    with pytest.raises(InputError) as caught:
        read(robot_bag(tmp_path / "bag", **how))
    assert said in str(caught.value) and "\n" not in str(caught.value)


# name: keywords of the bag, and when scans go on alone
REPLAYED = {
    "odometry dies": ({"odom": lambda n, says: says if n <= 190 else None}, "from 3.9 to 5.9 s"),
    "odometry pauses": ({"odom": lambda n, says: None if 100 <= n <= 170 else says}, "from 2.0 to 3.4 s"),
    "beams change": ({"scan": lidar}, ""),
    "scans 0.3 s ahead": ({"late_s": 0.3}, ""),
}


@pytest.mark.parametrize("name", REPLAYED)
def test_a_replay_has_the_true_poses_at_the_stamps_of_the_log_and_its_folder_gives_them_again(name, tmp_path, caplog):
    how, said = REPLAYED[name]
    bag, ahead_s = robot_bag(tmp_path / "bag", **how), how.get("late_s", 0.0)
    caplog.set_level("INFO")
    run = ss.replay(bag, progress=False, out=tmp_path / "out")
    gap = read(bag)[1].get("gap")
    assert (gap.place if gap else "") == said and ("note" in caplog.text) == bool(said or ahead_s)
    truth = np.array([way(0.1 * k).array() for k in range(60)])
    table = np.loadtxt(tmp_path / "out" / "estimate.tum")
    assert len(run.trace.estimates) == 60 and table[:, 0] == pytest.approx(1e-9 * T0_NS + ahead_s + 0.1 * np.arange(60))
    started = Pose.from_array(run.trace.estimates[0])
    found = np.array([(started.inverse() @ Pose.from_array(pose)).array() for pose in run.trace.estimates])
    true = np.array([(way(0.0).inverse() @ Pose.from_array(pose)).array() for pose in truth])
    assert np.abs(found - true)[:, :2].max() < 0.02 and np.abs(found - true)[:, 2].max() < 0.01
    caplog.clear()
    again = ss.replay(tmp_path / "out", progress=False)
    stated = ss.replay(bag, ss.load_config(tmp_path / "out" / "config.toml"), progress=False)
    assert np.array_equal(again.trace.estimates, run.trace.estimates) and (said or "note" not in caplog.text)
    assert np.array_equal(stated.trace.estimates, run.trace.estimates)


@pytest.mark.parametrize("kind", ["mcap", "sqlite"])
def test_bags_are_known_by_content_and_without_metadata(kind, tmp_path):
    bag = robot_bag(tmp_path / "bag", kind)
    file = next(each for each in bag.iterdir() if each.suffix != ".yaml")
    shutil.copy(file, tmp_path / "robot.log")
    with pytest.raises(InputError, match=f"found a bag of another name, allowed: one that ends in {file.suffix}"):
        open_log(tmp_path / "robot.log")
    (tmp_path / "bare").mkdir()
    shutil.copy(file, tmp_path / "bare" / f"x_0{file.suffix}")
    whole = open_log(bag)
    for path in (file, tmp_path / "bare"):
        assert [tick.stamp_ns for tick in open_log(path).ticks] == [tick.stamp_ns for tick in whole.ticks]


def cut(path, share):
    """The bag with this share of the bytes of its file."""
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    return path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_bag_that_is_cut_short_within_its_first_chunk_is_refused_with_what_to_do(kind, share, tmp_path, complaint):
    said = complaint("replay", cut(robot_bag(tmp_path / "bag", kind, seconds=2.0), share), "--out", tmp_path / "out")
    assert not share or {"mcap": "mcap recover", "ros1": "rosbag reindex"}.get(kind, "") in said


@pytest.mark.parametrize("share", [0.6, 0.9, 0.999])
def test_a_bag_that_is_cut_short_is_read_as_far_as_its_chunks_go_and_says_so(share, tmp_path):
    """Its chunks of 1 MB have the messages of some 3 s."""
    fine = robot_bag(tmp_path / "bag", scan=lambda n, says: {**says, "step": says["step"] / 40.0, "count": 9600})
    whole = open_log(fine).ticks
    log = open_log(cut(fine, share))
    (finding,) = log.found
    assert finding.kind == "cut_short" and "bag.mcap is cut short" in str(finding)
    assert 0.3 * len(whole) < len(log.ticks) <= len(whole)
    for tick, other in zip(log.ticks[:-1], whole, strict=False):
        assert tick.stamp_ns == other.stamp_ns and tick.odometry == other.odometry
        assert (tick.scan is None) == (other.scan is None)


def test_a_bag_with_scans_alone_has_no_odometry_the_frame_of_the_mount_is_the_robot_and_its_run_says_so(tmp_path):
    run = ss.replay(robot_bag(tmp_path / "bag", odom=lambda *_: None, seconds=3.0), out=tmp_path / "out")
    log = open_log(tmp_path / "bag")
    assert not log.has_odometry and len(log.ticks) == 30
    assert log.scans[0].T_robot_laser.array() == pytest.approx(MOUNT.array())
    assert "no_odometry = true" in (tmp_path / "out" / "config.toml").read_text()
    steps = np.diff(run.trace.trajectory[:, :2], axis=0)  # no wheels have counted the way
    assert run.metrics["path_length_m"] == pytest.approx(np.hypot(*steps.T).sum()) and len(steps)
    assert np.array_equal(ss.replay(tmp_path / "out").trace.estimates, run.trace.estimates)
    assert not open_log(robot_bag(tmp_path / "with", seconds=1.0), odometry=False).has_odometry
