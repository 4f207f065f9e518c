"""Odometry from /tf of a bag, and bags without odometry."""

import numpy as np
import pytest
from test_rosbag import MOUNT, Bag, complaint, foreign, ranges_at, way

from sixthsense import cli
from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.sources.logs import open_log
from sixthsense.sources.logs.errors import LogError

S = 10**9


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


def test_the_frame_of_the_map_above_odometry_is_left_alone(tmp_path):
    log = open_log(transformed(tmp_path / "x", links=(("map", "odom"), ("odom", "base_link"))), LaserConfig())
    assert poses(log)[-1] == pytest.approx(way(1.95).array())


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


def test_a_mount_that_is_repeated_in_tf_is_a_mount(tmp_path):
    with Bag(tmp_path / "x", "ros1") as bag:
        for k in range(9):
            bag.transform("odom", "base_link", Pose(0.2 * k, 0, 0), stamp_ns=S + k * S)
            bag.transform("base_link", "laser_link", MOUNT, stamp_ns=S + k * S)
            bag.scan("/scan", S + k * S, np.ones(240))
    log = open_log(bag.path, LaserConfig())
    assert log.scans[0].T_robot_laser.array() == pytest.approx(MOUNT.array())


def test_a_frame_with_two_parents_is_refused_unless_one_is_named(tmp_path):
    path = transformed(tmp_path / "x", links=(("odom", "base_link"), ("map", "base_link")))
    with pytest.raises(LogError, match=r"/tf: found base_link with the parents map and odom, allowed: one, or --odom"):
        open_log(path, LaserConfig())
    log = open_log(path, LaserConfig(), odometry_frames=("odom", "base_link"))
    assert poses(log)[-1] == pytest.approx(way(1.95).array())


def test_without_a_mount_the_only_moving_pair_is_odometry_and_the_laser_is_said_to_be_at_the_centre(tmp_path):
    log = open_log(transformed(tmp_path / "x", mount=False), LaserConfig())
    assert poses(log)[-1] == pytest.approx(way(1.95).array())
    assert any("assumed: the laser at the robot's centre" in line for line in log.remarks())
    with pytest.raises(LogError, match=r"found a -> b, odom -> base_link, of which none leads to the laser"):
        open_log(transformed(tmp_path / "y", links=(("odom", "base_link"), ("a", "b")), mount=False), LaserConfig())


def test_jumps_and_gaps_of_odometry_are_told(tmp_path):
    def jumping(t):
        return Pose(0.5 * t + 7.0 * (t > 1.0), 0.0, 0.0)

    remarks = open_log(transformed(tmp_path / "x", at=jumping), LaserConfig()).remarks()
    assert any("odometry jumps 1 times, by up to 7.0 m after 1.0 s" in line for line in remarks)
    with Bag(tmp_path / "y", "mcap") as bag:
        for k in [*range(20), *range(60, 80)]:
            bag.odometry("/odom", S + k * S // 20, Pose(0.01 * k, 0, 0))
            bag.scan("/scan", S + k * S // 20, np.ones(240))
    remarks = open_log(bag.path, LaserConfig()).remarks()
    assert any("odometry has 1 gaps, the longest of 2.0 s" in line for line in remarks)


def test_frames_that_are_not_in_tf_are_refused_in_one_line(tmp_path, capsys):
    path = transformed(tmp_path / "x")
    args = ["replay", str(path), "--out", str(tmp_path / "out"), "--odometry-frames"]
    assert "found no way from odom -> base, but odom -> base_link, allowed: frames of /tf" in complaint(
        [*args, "odom,base"], capsys
    )
    assert "--odometry-frames: found 'odom', allowed: PARENT,CHILD" in complaint([*args, "odom"], capsys)
    (tmp_path / "a.log").write_text("")
    found = complaint(["replay", str(tmp_path / "a.log"), "--odometry-frames", "odom,base_link"], capsys)
    assert "--odometry-frames: found on a log that is not a ROS bag" in found


def test_a_bag_with_scans_alone_has_no_odometry_and_the_frame_of_the_mount_is_the_robot(tmp_path):
    with Bag(tmp_path / "x", "mcap") as bag:
        bag.transform("base_link", "laser_link", MOUNT)
        for k in range(9):
            bag.scan("/scan", S + k * S, np.ones(240))
    log = open_log(bag.path, LaserConfig())
    assert not log.has_odometry and len(log.ticks) == 9
    assert log.scans[0].T_robot_laser.array() == pytest.approx(MOUNT.array())
    assert not open_log(foreign(tmp_path / "y", "mcap"), LaserConfig(), odometry=False).has_odometry


def test_odometry_that_stands_while_the_scans_change_is_told_with_what_to_do(tmp_path):
    def standing(t):
        return Pose(1.0, 0.0, 0.0)

    moving = open_log(transformed(tmp_path / "x", at=standing, duration_s=6.0), LaserConfig()).remarks()
    assert any("the odometry never changes, but the scans do: use --no-odometry" in line for line in moving)
    with Bag(tmp_path / "y", "mcap") as bag:
        for k in range(9):
            bag.odometry("/odom", S + k * S, Pose())
            bag.scan("/scan", S + k * S, np.ones(240))
    assert any("taken to stand still" in line for line in open_log(bag.path, LaserConfig()).remarks())


def test_a_bag_without_odometry_is_replayed_with_a_line_that_says_so(tmp_path, capsys):
    with Bag(tmp_path / "x", "mcap") as bag:
        for k in range(40):
            bag.scan("/scan", S + k * S // 10, ranges_at(0.1 * k))
    assert cli.main(["replay", str(bag.path), "--out", str(tmp_path / "out")]) == cli.DONE
    assert "no odometry is used" in capsys.readouterr().err
    assert "no_odometry = true" in (tmp_path / "out" / "config.toml").read_text()
    assert cli.main(["replay", str(tmp_path / "out"), "--out", str(tmp_path / "again")]) == cli.DONE
