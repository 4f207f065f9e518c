"""Odometry from /tf of a bag, and bags without odometry."""

import numpy as np
import pytest
from test_rosbag import MOUNT, Bag, foreign, ranges_at, way

from sixthsense import cli
from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.sources.logs import open_log

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
