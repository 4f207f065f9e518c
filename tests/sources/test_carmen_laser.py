"""What a CARMEN log says of its laser, of unlike robots and loggers."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import sixthsense as ss
from sixthsense import cli
from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.ray_casting import cast_rays
from sixthsense.sources.logs.carmen import read_carmen
from sixthsense.sources.logs.laser_geometry import max_range_of
from sixthsense.sources.logs.log import Log

ROOM = np.array([[[-3, -2], [4, -2]], [[4, -2], [4, 3]], [[4, 3], [-3, 3]], [[-3, 3], [-3, -2]]], dtype=np.float64)


def pose_text(pose: Pose, decimals: int = 6) -> str:
    return " ".join(f"{value:.{decimals}f}" for value in (pose.x, pose.y, pose.theta))


def flaser(ranges: Sequence[float], stamp: float = 1.0, robot: Pose | None = None, laser: Pose | None = None) -> str:
    robot = robot or Pose()
    poses = f"{pose_text(laser or robot)} {pose_text(robot)}"
    return f"FLASER {len(ranges)} {' '.join(f'{r:.2f}' for r in ranges)} {poses} {stamp:.6f} nohost {stamp:.6f}\n"


def robotlaser(
    ranges: Sequence[float],
    stamp: float = 1.0,
    head: str = "-1.570796 3.141593 0.017453 81.92",
    remissions: str = "0 ",
    robot: Pose | None = None,
    mount: Pose | None = None,
) -> str:
    robot = robot or Pose()
    poses = f"{pose_text(robot @ (mount or Pose()))} {pose_text(robot)}"
    text = " ".join(f"{r:.2f}" for r in ranges)
    rest = f"0.1 0.0 0.4 0.2 1.0 {stamp:.6f} nohost {stamp:.6f}"
    return f"ROBOTLASER1 0 {head} 0.01 0 {len(ranges)} {text} {remissions}{poses} {rest}\n"


def read(folder: Path, text: str, laser: LaserConfig | None = None, stated: Sequence[str] = ()) -> Log:
    file = folder / "some.log"
    file.write_text(text)
    return read_carmen(file, laser, stated)


def path_of(count: int) -> list[Pose]:
    return [Pose(0.05 * k, 0.02 * k, 0.03 * k) for k in range(count)]


@pytest.mark.parametrize(
    ("count", "last_deg", "step_deg"),
    [(180, 89.0, 1.0), (181, 90.0, 1.0), (360, 89.5, 0.5), (361, 90.0, 0.5), (90, 88.0, 2.0), (721, 90.0, 0.25)],
)
def test_the_beams_of_a_flaser_line_follow_from_their_number(
    tmp_path: Path, count: int, last_deg: float, step_deg: float
) -> None:
    log = read(tmp_path, flaser(np.linspace(1.0, 2.0, count)))
    bearings = np.degrees(log.scans[0].bearings)
    assert bearings[0] == pytest.approx(-90.0, abs=1e-5)
    assert bearings[-1] == pytest.approx(last_deg, abs=1e-4)
    assert np.diff(bearings) == pytest.approx(np.full(count - 1, step_deg), abs=1e-5)
    assert log.laser is not None and log.laser.beams == count
    assert log.laser.fov == pytest.approx(math.radians(last_deg + 90.0))
    assert any(f"{count} beams from -90 to {last_deg:g} degrees" in line for line in log.remarks())


def test_the_configuration_of_a_replay_reads_the_same_log_again(tmp_path: Path) -> None:
    text = "".join(flaser([1.0, 2.0, 3.0, 4.0], k, p, p @ Pose(-0.04, 0.0, 0.1)) for k, p in enumerate(path_of(5)))
    log = read(tmp_path, text)
    again = read(tmp_path, text, log.laser)
    assert again.laser == log.laser
    assert [t.scan.bearings.tolist() for t in again.ticks if t.scan] == [
        t.scan.bearings.tolist() for t in log.ticks if t.scan
    ]


def test_the_mount_is_the_difference_of_the_two_poses_of_a_scan(tmp_path: Path) -> None:
    for mount in (Pose(), Pose(-0.04, 0.0, 0.0), Pose(0.2, -0.1, 0.4), Pose(0.1, 0.0, math.pi)):
        log = read(tmp_path, "".join(flaser([1, 2, 3, 4], k, p, p @ mount) for k, p in enumerate(path_of(40))))
        found = log.scans[0].T_robot_laser
        assert (found.x, found.y) == pytest.approx((mount.x, mount.y), abs=2e-6)
        assert math.cos(found.theta - mount.theta) == pytest.approx(1.0, abs=1e-9)
        assert not any("laser.mount" in line for line in log.remarks())


def scans_of_a_drive(code: float | None, max_range: float, spacing: float) -> list[np.ndarray]:
    """60 scans in a room whose far side is beyond reach, `code` for no return, ranges rounded to `spacing`."""
    far = ROOM * max_range / 3.2
    scans = []
    for k in range(60):
        ranges = cast_rays(Pose(0.02 * k, 0.0, 0.05 * k), np.linspace(-1.57, 1.57, 181), far, max_range)
        ranges = np.round(ranges / spacing) * spacing
        scans.append(np.where(np.isfinite(ranges), ranges, np.inf if code is None else code).astype(np.float32))
    return scans


@pytest.mark.parametrize("max_range", [4.0, 80.0])
@pytest.mark.parametrize("spacing", [0.001, 0.01])
@pytest.mark.parametrize("beyond", [0.0, 0.02])
def test_the_value_that_beams_without_a_return_repeat_is_found(max_range: float, spacing: float, beyond: float) -> None:
    code = max_range * (1.0 + beyond)
    scans = scans_of_a_drive(code, max_range, spacing)
    assert sum((scan == np.float32(code)).sum() for scan in scans) > 100
    found = max_range_of(scans)
    assert 0.996 * code <= found <= code  # what is lost are the last thousandths of the reach


def test_a_robotlaser_line_states_its_own_geometry(tmp_path: Path) -> None:
    mount = Pose(0.1, 0.02, 0.3)
    poses = path_of(6)
    head = "-2.356194 4.712389 1.570796 30.00"
    lines = [robotlaser([1, 2, 3, 4], k, head, robot=p, mount=mount) for k, p in enumerate(poses)]
    log = read(tmp_path, "".join(lines))
    scan = log.scans[0]
    assert scan.bearings == pytest.approx([-2.356194, -0.785398, 0.785398, 2.356194], abs=1e-5)
    assert scan.max_range == 30.0
    assert (scan.T_robot_laser.x, scan.T_robot_laser.theta) == pytest.approx((0.1, 0.3), abs=2e-6)
    assert [tick.odometry.x for tick in log.ticks] == pytest.approx([pose.x for pose in poses])
    assert log.ticks[3].log_stamp_s == 3.0
    assert log.remarks() == []


def drive_pose(k: int) -> Pose:
    return Pose(0.5 * math.sin(0.1 * k), 0.3 * math.sin(0.07 * k), 0.05 * k)


def drive(folder: Path, mount: Pose, name: str = "drive.log") -> Path:
    """A drive around a room with a scanner of 180 degrees, 181 beams, reach 8 m, code 8.19."""
    lines = []
    for k in range(60):
        robot = drive_pose(k)
        ranges = cast_rays(robot @ mount, np.linspace(-math.pi / 2, math.pi / 2, 181), ROOM[:3], 8.0)
        ranges = np.where(np.isfinite(ranges), ranges, 8.19)
        lines.append(flaser(ranges, 100.0 + 0.2 * k, robot, robot @ mount))
    file = folder / name
    file.write_text("".join(lines))
    return file


def test_an_unknown_log_is_replayed_with_the_defaults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, relations = drive(tmp_path, Pose(0.2, 0.05, 0.0)), tmp_path / "some.relations"
    between = drive_pose(0).inverse() @ drive_pose(50)
    relations.write_text(f"100 110 {between.x} {between.y} 0 0 0 {between.theta}\n")
    args = ["replay", str(file), "--relations", str(relations), "--out", str(tmp_path / "out")]
    assert cli.main(args) == cli.DONE
    said = capsys.readouterr().err
    assert "181 beams from -90 to 90 degrees" in said and "ranges from 8.17 m on are no returns" in said
    run = ss.load(tmp_path / "out")
    assert run.trace.config.laser.mount == (0.2, 0.05, 0.0)
    assert run.outcome == "log ended"
    assert run.metrics["relations_trans_m_mean"] < 0.05


@pytest.mark.parametrize(
    ("name", "beams", "first_deg", "mount", "code"),
    [("intel", 180, -90.0, (0.0, 0.0, 0.0), 81.83), ("fr079", 360, -90.0, (-0.04, 0.0, 0.0), 81.91)],
)
def test_real_logs_say_what_their_lasers_are(
    data_dir: Path, name: str, beams: int, first_deg: float, mount: tuple[float, float, float], code: float
) -> None:
    log = ss.open_log(data_dir / name / f"{name}.clf.bz2")
    assert log.laser is not None
    assert (log.laser.beams, log.laser.mount) == (beams, mount)
    assert np.degrees(log.scans[0].bearings[0]) == pytest.approx(first_deg, abs=1e-5)
    assert 0.996 * code < log.laser.max_range < code
    assert max(float(scan.ranges[np.isfinite(scan.ranges)].max()) for scan in log.scans[::10]) < 40.0
