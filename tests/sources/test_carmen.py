import bz2
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from sixthsense.config import LaserConfig
from sixthsense.core.source import Command
from sixthsense.sources.logs import open_log
from sixthsense.sources.logs.carmen import read_carmen
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.relations import read_relations

LASER = LaserConfig(beams=4, fov=math.pi / 2, max_range=50.0)
HEADER = "# message_name [message contents] ipc_timestamp\nPARAM robot_frontlaser_offset 0.0 nohost 0\n"


def odom(stamp: object = 1.0, x: object = 0.0, y: object = 0.0, theta: object = 0.0) -> str:
    return f"ODOM {x} {y} {theta} 0.1 0.2 0.0 {stamp} nohost 0.5\n"


def flaser(stamp: object = 1.0, ranges: str = "1.0 2.0 3.0 81.83", robot: str = "4.0 5.0 0.6") -> str:
    return f"FLASER {len(ranges.split())} {ranges} 9.0 9.0 0.9 {robot} {stamp} nohost 0.5\n"


def written(folder: Path, text: str | bytes, name: str = "some.log") -> Path:
    file = folder / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def stamps(log: Log) -> list[int]:
    return [tick.stamp_ns for tick in log.ticks]


def error_of(file: Path, laser: LaserConfig = LASER) -> str:
    with pytest.raises(LogError) as caught:
        read_carmen(file, laser)
    assert "\n" not in str(caught.value)
    assert str(file) in str(caught.value)
    return str(caught.value)


def test_a_log_has_one_tick_per_odometry_or_laser_line_in_the_order_of_the_file(tmp_path: Path) -> None:
    lines = [HEADER, odom(1, x=1), "SYNC start\n", flaser(2), "\n", "RLASER 1 2.0\n", "NMEA-GGA x\n", odom(3, x=7)]
    log = read_carmen(written(tmp_path, "".join(lines)), LASER)
    seen = []
    while (tick := log.step(Command(1.0, 1.0))) is not None:
        seen.append(tick)
    assert [tick.odometry.x for tick in seen] == [1.0, 4.0, 7.0]
    assert [tick.scan is not None for tick in seen] == [False, True, False]
    assert log.step(Command()) is None
    assert len(log.scans) == 1
    assert log.start == seen[0].odometry
    assert log.duration_s == pytest.approx(2.0)


def test_the_odometry_of_a_scan_is_the_robots_and_not_the_lasers(tmp_path: Path) -> None:
    tick = read_carmen(written(tmp_path, flaser(robot="1.0 -2.0 0.5")), LASER).step(Command())
    assert tick is not None
    assert tick.odometry.array() == pytest.approx([1.0, -2.0, 0.5])


def test_ranges_at_or_beyond_the_maximum_are_no_returns(tmp_path: Path) -> None:
    scan = read_carmen(written(tmp_path, flaser(ranges="0.0 49.99 50.0 inf")), LASER).scans[0]
    assert scan.ranges.tolist() == [0.0, pytest.approx(49.99), math.inf, math.inf]


def test_a_scan_has_the_mount_and_the_bearings_of_the_laser(tmp_path: Path) -> None:
    laser = LaserConfig(beams=4, fov=math.pi, max_range=50.0, mount=(0.1, 0.0, 0.2))
    scan = read_carmen(written(tmp_path, flaser()), laser).scans[0]
    assert scan.T_robot_laser.array() == pytest.approx([0.1, 0.0, 0.2])
    assert scan.bearings == pytest.approx(np.linspace(-math.pi / 2, math.pi / 2, 4), abs=1e-6)


def test_record_stamps_ascend_strictly_for_any_stamps_in_the_log(tmp_path: Path) -> None:
    for seed in range(10):
        own = np.random.default_rng(seed).uniform(0.0, 1.0, 50).round(2)
        log = read_carmen(written(tmp_path, "".join(flaser(stamp) for stamp in own)), LASER)
        assert np.all(np.diff(np.array(stamps(log))) > 0)
        assert log.backward_stamps == np.count_nonzero(np.diff(own) < 0)


@pytest.mark.parametrize("name", ["a.log", "a.log.gz", "a.clf.bz2"])
def test_plain_and_compressed_logs_give_the_same_result_under_any_name(tmp_path: Path, name: str) -> None:
    text = (HEADER + odom() + flaser(2)).encode()
    for content in (text, gzip.compress(text), bz2.compress(text)):
        log = open_log(written(tmp_path, content, name), LASER)
        assert stamps(log) == [10**9, 2 * 10**9]


@pytest.mark.parametrize("line", [odom(12.5), flaser(12.5)])
def test_a_last_line_cut_short_is_left_out_with_a_remark(tmp_path: Path, line: str) -> None:
    for length in range(1, line.rindex(" ") + 1):
        log = read_carmen(written(tmp_path, flaser() + line[:length]), LASER)
        assert len(log.ticks) == 1
        assert log.remarks()[0].startswith("the last line is damaged and left out (line 2: found ")
        assert "\n" not in log.remarks()[0]


@pytest.mark.parametrize("compress", [gzip.compress, bz2.compress])
def test_a_truncated_compressed_log_is_refused(tmp_path: Path, compress) -> None:
    ranges = np.random.default_rng(0).uniform(0, 9, (40, 4)).round(3)
    content = compress("".join(flaser(i, " ".join(map(str, row))) for i, row in enumerate(ranges)).encode())
    for length in range(len(content) - 1, 3, -17):
        error_of(written(tmp_path, content[:length], "a.log.gz"))
    damaged = bytearray(content)
    damaged[len(content) // 2] ^= 0xFF
    error_of(written(tmp_path, bytes(damaged)))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2 3 4 5 6 7 8\n1 2 3\n", "line 2: found 3 fields, allowed: 8"),
        ("1 2 3 4 5 6 7 x\n", "line 1: found 'x', allowed: a number"),
        ("1 2 nan 4 5 6 7 8\n", "line 1: found 'nan', allowed: a finite number"),
        ("# nothing\n", "found no line of numbers"),
    ],
)
def test_bad_relations_are_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(LogError) as caught:
        read_relations(written(tmp_path, text, "a.relations"))
    assert said in str(caught.value)
    assert str(tmp_path) in str(caught.value)
