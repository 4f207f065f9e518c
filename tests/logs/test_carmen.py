"""CARMEN logs: their lines, and what they say of the laser of unlike robots and loggers."""

import bz2
import gzip
import itertools
import lzma
import math
from pathlib import Path

import numpy as np
import pytest

from sixthsense.config import LaserConfig, preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.ray_casting import cast_rays
from sixthsense.logs import open_log
from sixthsense.logs.carmen import read_carmen
from sixthsense.logs.diagnose import settled
from sixthsense.logs.laser_geometry import max_range_of
from sixthsense.logs.log import Log

LASER = LaserConfig(beams=4, fov=math.pi, max_range=50.0)
HEADER = "# message_name [message contents] ipc_timestamp\nPARAM robot_frontlaser_offset 0.0 nohost 0\n"
PLACE, CENTRE, ASIDE = Pose(4.0, 5.0, 0.6), Pose(), Pose(0.17, -0.06, 0.35)
ROOM = np.array([[[-3, -2], [4, -2]], [[4, -2], [4, 3]], [[4, 3], [-3, 3]], [[-3, 3], [-3, -2]]], dtype=np.float64)


def pose_text(pose: Pose) -> str:
    return " ".join(f"{value:.6f}" for value in (pose.x, pose.y, pose.theta))


def odom(stamp: float = 1.0, x: float = 0.0) -> str:
    return f"ODOM {x} 0.0 0.0 0.1 0.2 0.0 {stamp} nohost 0.5\n"


def flaser(stamp: float | str = 1.0, ranges=(1.0, 2.0, 3.0, 81.83), robot: Pose = PLACE, mount=CENTRE) -> str:
    poses = f"{pose_text(robot @ mount)} {pose_text(robot)}"
    return f"FLASER {len(ranges)} {' '.join(f'{r:.2f}' for r in ranges)} {poses} {stamp} nohost {stamp}\n"


def written(folder: Path, text: str | bytes, name: str = "some.log") -> Path:
    file = folder / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def read(folder: Path, text: str, laser: LaserConfig | None = None) -> Log:
    return read_carmen(written(folder, text), laser)


def test_a_line_of_odometry_or_of_the_laser_is_a_tick_and_a_damaged_one_costs_itself_and_is_counted(
    tmp_path: Path,
) -> None:
    other = ["\n", "SYNC start\n", "RLASER 1 2.0\n", "NMEA-GGA x\n"]
    bad = [flaser().replace(" 2.00 ", " abc "), "FLASER 1 2.0 1 2 3 1 2 3 7 h 7\n", flaser()[:20] + "\n"]
    seen = flaser(2, (math.nan, -1.0, 3.0, -math.inf), Pose(4.0))
    log = read(tmp_path, "".join([HEADER, odom(1, x=1), *other, *bad, seen, bad[0], odom(3, x=7)]), LASER)
    assert [tick.odometry.x for tick in log.ticks] == [1.0, 4.0, 7.0]
    assert [tick.log_stamp_s for tick in log.ticks] == [None, 2.0, None]
    assert log.scans[0].ranges.tolist() == [math.inf, math.inf, 3.0, math.inf]
    assert log.start == log.ticks[0].odometry and log.duration_s == pytest.approx(2.0)
    (lines,) = log.found
    assert lines.value == 4.0 and "line 8: found 'abc', allowed: a number" in lines.place
    with pytest.raises(InputError, match=r"line 1: found 'abc', allowed: a number$"):
        read(tmp_path, bad[0], LASER)


@pytest.mark.parametrize("jump", [Pose(100.0, 0.0, 0.0), Pose(3.0, -2.0, 0.7), Pose(-1.0, 0.3, 2.0)])
def test_odometry_that_jumps_goes_on_from_where_it_was(tmp_path: Path, jump: Pose) -> None:
    poses = [Pose(0.05 * k, 0.02 * k, 0.03 * k) for k in range(40)]
    jumped = [*poses[:20], *(jump @ pose for pose in poses[20:])]
    stamps, ranges = 0.1 * np.arange(40), [[1.0, 2.0, 3.0, 4.0]] * 40
    log, as_before = (read(tmp_path, "".join(map(flaser, stamps, ranges, way))) for way in (jumped, poses))
    said, before = ([each.kind for each in settled(one, preset("log"))[2]] for one in (log, as_before))
    assert said.count("jump") == 1 and "jump" not in before
    for tick, before in zip(log.ticks[:20], as_before.ticks, strict=False):
        assert tick.odometry == before.odometry
    assert log.ticks[20].odometry.array() == pytest.approx(log.ticks[19].odometry.array(), abs=1e-9)
    motions = [(a.odometry.inverse() @ b.odometry).array() for a, b in itertools.pairwise(log.ticks[20:])]
    expected = [(a.inverse() @ b).array() for a, b in itertools.pairwise(poses[20:])]
    assert np.allclose(motions, expected, atol=1e-5)


@pytest.mark.parametrize("name", ["a.log.gz", "a.clf.bz2", "a.dat.xz", "a"])
def test_plain_and_compressed_logs_give_the_same_result_under_any_name(tmp_path: Path, name: str) -> None:
    text = (HEADER + odom() + flaser(2)).encode()
    mark, short = b"\xef\xbb\xbf", text[len(HEADER) :]
    for content in (text, gzip.compress(text), bz2.compress(text), lzma.compress(text), mark + short):
        log = open_log(written(tmp_path, content, name), LASER)
        assert [tick.stamp_ns for tick in log.ticks] == [10**9, 2 * 10**9]


@pytest.mark.parametrize(("count", "span_deg", "step_deg", "side", "turn_rad", "found_deg"), [
    (181, 180.0, 1.0, 1.0, 0.06, 180.0),
    (682, 239.4140625, 0.3515625, 1.0, 0.06, 239.4140625),
    (541, 270.0, 0.5, 1.0, 0.06, 270.0),
    (360, 360.0, 1.0, 1.0, -0.06, 360.0),
    (541, 270.0, 0.5, -1.0, 0.06, 270.0),
    (541, 270.0, 0.5, 1.0, 0.004, 180.0),
])  # fmt: skip
def test_the_field_of_view_of_flaser_lines_is_that_which_the_turns_of_odometry_fit(
    tmp_path: Path, count: int, span_deg: float, step_deg: float, side: float, turn_rad: float, found_deg: float
) -> None:
    """Of 60 scans of a robot that turns on the spot; the last one turns too little in all."""
    bearings, lines = np.radians(-span_deg / 2.0 + step_deg * np.arange(count)), []
    for k in range(60):
        pose = Pose(0.3 + 0.002 * k, -0.4, 0.2 + turn_rad * k)
        ranges = cast_rays(pose, side * bearings, ROOM, 20.0)
        lines.append(flaser(0.1 * k, ranges, PLACE @ Pose(pose.x, pose.y, 1.03 * (0.2 + turn_rad * k))))
    log, _, found = settled(read(tmp_path, "".join(lines)), preset("log"))
    kinds = {finding.kind: finding for finding in found}
    assert np.degrees(log.scans[0].bearings[0]) == pytest.approx(-found_deg / 2.0, abs=0.01)
    assert ("turned_around" in kinds) == (side < 0.0)
    assert ("by the turns" in str(kinds.get("assumed_beams"))) == (found_deg == 180.0 and turn_rad > 0.01)
    if found_deg == span_deg and side > 0.0:
        assert log.scans[0].bearings == pytest.approx(bearings, abs=1e-5)
    if found_deg > 180.0:  # which the configuration of the run has: read again, nothing is left to be found
        again, _, found = settled(read(tmp_path, "".join(lines), log.laser), preset("log"))
        assert again.scans[7].bearings == pytest.approx(log.scans[7].bearings, abs=1e-9)
        assert not {finding.kind for finding in found} & {"field_of_view", "assumed_beams"}


@pytest.mark.parametrize(("max_range", "beyond"), [(4.0, 0.0), (4.0, 0.02), (80.0, 0.02)])
def test_the_value_that_beams_without_a_return_repeat_is_found(max_range: float, beyond: float) -> None:
    """In a room whose far side is beyond reach; what is lost are the last thousandths of the reach."""
    code, far, scans = max_range * (1.0 + beyond), ROOM * max_range / 3.2, []
    for k in range(60):
        ranges = cast_rays(Pose(0.02 * k, 0.0, 0.05 * k), np.linspace(-1.57, 1.57, 181), far, max_range)
        scans.append(np.where(np.isfinite(ranges), ranges.round(2), code).astype(np.float32))
    assert 0.996 * code <= max_range_of(scans) <= code


@pytest.mark.parametrize(("stamp", "said"), [
    (lambda t: f"{1134860123 + t:.3f}", ""), (lambda t: f"{1134860123 + t:g}", "stamps"),
    (lambda t: f"{1134863123 + 100 * t:g}", "stamps"), (lambda t: f"{1000 * t:g}", "stamps_unit"),
    (lambda t: "0", "stamps"), (lambda t: f"{t - 5:.3f}", ""),
])  # fmt: skip
def test_stamps_that_tell_no_time_leave_odometry_as_it_is(stamp, said: str, tmp_path: Path) -> None:
    lines = [flaser(stamp(2.0 * k), robot=Pose(1.2 * k, 1.5, 0.2)) for k in range(24)]
    log, _, found = settled(read(tmp_path, "".join(lines)), preset("log"))
    assert [tick.odometry.x for tick in log.ticks] == pytest.approx(1.2 * np.arange(24))
    assert (np.diff([tick.stamp_ns for tick in log.ticks]) > 0).all() and log.ticks[0].stamp_ns >= 0
    assert {each.kind for each in found} == {"assumed_beams", said} - {""}


def test_each_robotlaser_line_has_its_own_beams(tmp_path: Path) -> None:
    def line(k: int) -> str:
        off = (0, 1, 3, 2)[k % 4]
        count, start, robot = 181 - (off > 0), math.radians(-90 + 0.25 * off), Pose(0.1 * k, 0.2, 0.3)
        ranges = " ".join(f"{2.0 + 0.01 * i:.2f}" for i in range(count))
        angles = f"{start:.6f} {math.radians(count - 1):.6f} {math.radians(1):.6f}"
        poses = f"{pose_text(robot @ ASIDE)} {pose_text(robot)}"
        return f"ROBOTLASER1 0 {angles} 81.9 0.01 0 {count} {ranges} 0 {poses} 0 0 0 0 0 {k} h {k}\n"

    log = read(tmp_path, "".join(map(line, range(24))))
    assert [len(scan.ranges) for scan in log.scans[:4]] == [181, 180, 180, 180]
    first_deg = np.degrees([scan.bearings[7] for scan in log.scans[:4]])
    assert first_deg == pytest.approx([-83, -82.75, -82.25, -82.5], abs=1e-3)
    assert log.scans[3].max_range == 81.9 and log.ticks[3].log_stamp_s == 3.0
    assert log.scans[3].T_robot_laser.array() == pytest.approx(ASIDE.array(), abs=2e-6)
    assert log.ticks[7].odometry.array() == pytest.approx([0.7, 0.2, 0.3])
    with pytest.raises(InputError, match="found angles of -90 to 90, which are degrees"):
        read(tmp_path, line(0).replace("-1.570796 3.141593 0.017453", "-90 180 1"))
