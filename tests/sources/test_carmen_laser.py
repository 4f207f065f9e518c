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
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.laser_geometry import beams_as_stated, beams_by_count, max_range_of, no_return_code
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


def test_a_field_of_view_that_is_set_takes_precedence_over_the_number_of_beams(tmp_path: Path) -> None:
    line = flaser(np.linspace(1.0, 2.0, 270))
    wide = read(tmp_path, line, LaserConfig(fov=math.radians(269.0))).scans[0]
    assert np.degrees(wide.bearings[[0, -1]]) == pytest.approx([-134.5, 134.5], abs=1e-4)
    circle = read(tmp_path, line, LaserConfig(), ["fov"])
    assert circle.scans[0].closed and circle.laser is not None and circle.laser.fov == 2.0 * math.pi
    assert not any("assumed" in line for line in circle.remarks())


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


def test_one_wrong_pose_does_not_change_the_mount(tmp_path: Path) -> None:
    lines = [flaser([1, 2, 3, 4], k, p, p @ Pose(0.1, 0, 0)) for k, p in enumerate(path_of(40))]
    lines[7] = flaser([1, 2, 3, 4], 7, path_of(8)[7], Pose(55.0, 1.0, 2.0))
    assert read(tmp_path, "".join(lines)).scans[0].T_robot_laser == Pose(0.1, 0.0, 0.0)


@pytest.mark.parametrize(("parameter", "ahead_m"), [("", 0.0), ("PARAM robot_frontlaser_offset -0.04 1 h 1\n", -0.04)])
def test_poses_corrected_by_a_scan_matcher_are_no_mount(tmp_path: Path, parameter: str, ahead_m: float) -> None:
    rng = np.random.default_rng(0)
    lines = [flaser([1, 2, 3, 4], k, p, p @ Pose(*rng.normal(0, 0.1, 3))) for k, p in enumerate(path_of(40))]
    log = read(tmp_path, parameter + "".join(lines))
    assert log.scans[0].T_robot_laser == Pose(ahead_m, 0.0, 0.0)
    assert sum("do not move as one body" in line for line in log.remarks()) == 1


def test_a_mount_that_is_set_takes_precedence(tmp_path: Path) -> None:
    text = "".join(flaser([1, 2, 3, 4], k, p, p @ Pose(0.1, 0, 0)) for k, p in enumerate(path_of(5)))
    assert read(tmp_path, text, LaserConfig(mount=(0.3, 0, 0))).scans[0].T_robot_laser == Pose(0.3, 0, 0)
    assert read(tmp_path, text, LaserConfig(), ["mount"]).scans[0].T_robot_laser == Pose()


def scans_of_a_drive(code: float | None, max_range: float, spacing: float) -> list[np.ndarray]:
    """60 scans in a room whose far side is beyond reach, `code` for no return, ranges rounded to `spacing`."""
    far = ROOM * max_range / 3.2
    scans = []
    for k in range(60):
        ranges = cast_rays(Pose(0.02 * k, 0.0, 0.05 * k), np.linspace(-1.57, 1.57, 181), far, max_range)
        ranges = np.round(ranges / spacing) * spacing
        scans.append(np.where(np.isfinite(ranges), ranges, np.inf if code is None else code).astype(np.float32))
    return scans


@pytest.mark.parametrize("max_range", [4.0, 8.0, 30.0, 50.0, 80.0])
@pytest.mark.parametrize("spacing", [0.001, 0.01])
@pytest.mark.parametrize("beyond", [0.0, 0.02])
def test_the_value_that_beams_without_a_return_repeat_is_found(max_range: float, spacing: float, beyond: float) -> None:
    code = max_range * (1.0 + beyond)
    scans = scans_of_a_drive(code, max_range, spacing)
    assert sum((scan == np.float32(code)).sum() for scan in scans) > 100
    found = max_range_of(scans)
    assert 0.996 * code <= found <= code  # what is lost are the last thousandths of the reach


def test_several_codes_of_a_sick_are_no_returns() -> None:
    scans = scans_of_a_drive(8.191, 8.0, 0.001)
    scans[3][20:25] = [8.190, 8.183, 8.187, 8.186, 8.189]
    found = no_return_code(scans)
    assert found is not None and 8.1 < found <= 8.183


def test_ranges_are_all_returns_where_no_value_repeats_at_the_top() -> None:
    scans = [scan[np.isfinite(scan)] for scan in scans_of_a_drive(None, 30.0, 0.01)]
    assert no_return_code(scans) is None
    assert max_range_of(scans) > max(float(scan.max()) for scan in scans)


def test_a_wall_seen_by_a_standing_robot_is_no_code_for_no_return() -> None:
    rng = np.random.default_rng(1)
    exact = cast_rays(Pose(), np.linspace(-1.57, 1.57, 181), ROOM, 30.0)
    scans = [np.round(exact + rng.normal(0, 0.005, 181), 2).astype(np.float32) for _ in range(2000)]
    assert no_return_code(scans) is None


def test_a_stated_maximum_range_is_used_where_no_value_repeats(tmp_path: Path) -> None:
    text = "PARAM robot_front_laser_max 20.0 1 h 1\n" + flaser([1.0, 19.0, 20.0, 81.91])
    assert np.isfinite(read(tmp_path, text).scans[0].ranges).tolist() == [True, True, False, False]
    text = robotlaser([1.0, 29.0, 30.0, 81.91], head="-1.5 3.0 1.0 30.0")
    assert np.isfinite(read(tmp_path, text).scans[0].ranges).tolist() == [True, True, False, False]


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


def test_a_robotlaser_line_may_have_remissions_or_lack_their_number(tmp_path: Path) -> None:
    plain, with_values = robotlaser([1, 2, 3, 4], 2.0), robotlaser([1, 2, 3, 4], 2.0, remissions="4 7.0 7.0 7.0 7.0 ")
    for text in (plain, with_values, robotlaser([1, 2, 3, 4], 2.0, remissions="")):
        log = read(tmp_path, text)
        assert log.scans[0].ranges.tolist() == [1, 2, 3, 4] and log.ticks[0].log_stamp_s == 2.0


def test_the_field_of_view_decides_where_the_resolution_contradicts_it() -> None:
    assert beams_as_stated(181, -1.0, math.pi, 0.0).step == pytest.approx(math.pi / 180)
    assert beams_as_stated(181, -1.0, math.pi, 0.3).step == pytest.approx(math.pi / 180)
    assert beams_as_stated(180, -1.0, math.pi, math.pi / 180).step == pytest.approx(math.pi / 180)
    assert beams_as_stated(4, -math.pi, 2.0 * math.pi, math.pi / 2) == (-math.pi, math.pi / 2)
    assert beams_by_count(180).step == beams_by_count(181).step


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("ROBOTLASER1 0 1 2\n", "found ROBOTLASER1 without ranges, a CARMEN line cut short"),
        (robotlaser([1, 2, 3, 4]).replace(" 4 1.00", " x 1.00"), "found 'x' ranges in ROBOTLASER1"),
        (robotlaser([1, 2, 3, 4])[:-30] + "\n", "found ROBOTLASER1 with 4 ranges and 0 remissions of"),
        (
            robotlaser([1, 2, 3, 4], head="-90 180 1 80"),
            "found start angle -90 and field of view 180, allowed: radians",
        ),
        (robotlaser([1, 2, -3, 4]), "found range '-3.00'"),
    ],
)
def test_a_damaged_robotlaser_line_is_named(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(LogError) as caught:
        read(tmp_path, robotlaser([1, 2, 3, 4]) + line + robotlaser([1, 2, 3, 4]))
    assert "line 2: " in str(caught.value) and said in str(caught.value)


@pytest.mark.parametrize(
    ("flasers", "robotlasers", "used"), [(5, 5, "ROBOTLASER1"), (6, 5, "FLASER"), (2, 5, "ROBOTLASER1")]
)
def test_of_two_kinds_of_scans_the_more_frequent_is_used(
    tmp_path: Path, flasers: int, robotlasers: int, used: str
) -> None:
    text = "".join(flaser([1, 2, 3, 4], k) for k in range(flasers))
    text += "".join(robotlaser([5, 6, 7, 8, 9], k) for k in range(robotlasers))
    log = read(tmp_path, text)
    assert len(log.ticks) == len(log.scans) == (flasers if used == "FLASER" else robotlasers)
    assert any(line.endswith(f"the scans are those of {used}") for line in log.remarks())


def test_scans_of_another_geometry_are_left_out_and_counted(tmp_path: Path) -> None:
    lines = [flaser([1, 2, 3, 4], k, p) for k, p in enumerate(path_of(9))]
    lines[4], lines[6] = flaser([1, 2, 3], 4, path_of(5)[4]), flaser([], 6, path_of(7)[6])
    log = read(tmp_path, "".join(lines))
    assert len(log.ticks) == 9 and len(log.scans) == 7
    assert log.ticks[4].scan is None and log.ticks[4].odometry.x == pytest.approx(0.2)
    assert "2 scans of another geometry (0, 3 beams) are left out" in log.remarks()


def test_a_log_of_a_single_beam_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="found scans of 1 beams, allowed: 2 to 100000"):
        read(tmp_path, flaser([1.0]) + flaser([1.0], 2))


def test_a_log_without_any_return_is_refused(tmp_path: Path) -> None:
    codes = "".join(flaser([81.83] * 180, k) for k in range(20))
    for text in (codes, "".join(flaser([0.0] * 180, k) for k in range(20)), flaser([math.inf] * 4)):
        with pytest.raises(LogError, match=r"found no return in \d+ scans, allowed: ranges above 0 and below"):
            read(tmp_path, text)


def test_odometry_and_stamps_that_stand_still_are_remarked(tmp_path: Path) -> None:
    still = read(tmp_path, "".join(flaser([1, 2, 3, 4], k) for k in range(5)))
    assert sum("the odometry never changes" in line for line in still.remarks()) == 1
    stamped = read(tmp_path, "".join(flaser([1, 2, 3, 4], 7.0, p) for p in path_of(5)))
    assert "all 5 scans have the stamp 7.000000; replayed in the order of the file" in stamped.remarks()
    assert not any("odometry" in line for line in stamped.remarks())


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


def test_relations_of_stamps_that_are_not_in_the_log_are_left_out_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, relations = drive(tmp_path, Pose()), tmp_path / "some.relations"
    args = ["replay", str(file), "--relations", str(relations), "--out", str(tmp_path / "out"), "--overwrite"]
    relations.write_text("100 101 0 0 0 0 0 0\n100 999 0 0 0 0 0 0\n100.2 100.4 0 0 0 0 0 0\n")
    assert cli.main(args) == cli.DONE
    assert "1 of 3 relations name stamps of no scan and are left out" in capsys.readouterr().err
    relations.write_text("1 2 0 0 0 0 0 0\n100 2 0 0 0 0 0 0\n")
    assert cli.main(args) == cli.BAD_INPUT
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"{relations}: found no relation between scans of the log (the first is of 1.000000)" in error


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
