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


def test_ticks_keep_the_order_of_the_file_when_stamps_decrease(tmp_path: Path) -> None:
    log = read_carmen(written(tmp_path, odom(10) + flaser(11) + flaser(5) + odom(5) + flaser(11) + flaser(12)), LASER)
    s = 10**9
    assert stamps(log) == [10 * s, 11 * s, 11 * s + 1, 11 * s + 2, 11 * s + 3, 12 * s]
    assert [tick.log_stamp_s for tick in log.ticks] == [None, 11.0, 5.0, None, 11.0, 12.0]
    assert log.backward_stamps == 1


def test_stamps_keep_all_digits_of_the_log(tmp_path: Path) -> None:
    log = read_carmen(written(tmp_path, odom("976052857.337284123") + flaser("1e9")), LASER)
    assert stamps(log) == [976052857337284123, 10**18]


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


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("ODOM 1 2\n", "found ODOM of 3 fields, allowed: 10 (a CARMEN line cut short)"),
        ("ODOM 1 2 3 0 0 0 1.0 host 0.5 6\n", "found ODOM of 11 fields, allowed: 10"),
        (odom(x="one"), "found 'one', allowed: a number"),
        (odom(theta="nan"), "found 'nan', allowed: a finite number"),
        (odom(stamp="soon"), "found stamp 'soon'"),
        (odom(stamp="-1"), "found stamp '-1', allowed: 0 to"),
        (odom(stamp="1e300"), "found stamp '1e300'"),
        (flaser(robot="inf 0 0"), "found 'inf', allowed: a finite number"),
        (flaser(ranges="1 2 -0.5 4"), "found range '-0.5', allowed: metres, at least 0"),
        (flaser(ranges="1 2 nan 4"), "found range 'nan'"),
        (flaser(ranges="1 2 x 4"), "found 'x', allowed: a number"),
        ("FLASER\n", "cut short"),
        ("FLASER four 1 2 3 4\n", "found 'four' ranges in FLASER, allowed: a whole number"),
        ("FLASER -4 1 2 3 4\n", "found '-4' ranges"),
        ("FLASER 999999999999 1 2 3 4\n", "cut short"),
        (f"FLASER {'9' * 5000} 1 2 3 4\n", "ranges in FLASER, allowed: a whole number"),
        ("FLAS\n", "found 'FLAS', a CARMEN line cut short"),
        ("976052905.1 976052911.8 0 0 0 0 0 0\n", "found '976052905.1', allowed: a CARMEN message"),
    ],
)
def test_a_bad_line_is_named_with_what_was_found(tmp_path: Path, line: str, said: str) -> None:
    message = error_of(written(tmp_path, HEADER + flaser() + line + flaser(2)))
    assert f"{tmp_path / 'some.log'} line 4: " in message
    assert said in message
    assert len(message) < 300 + len(str(tmp_path))


def test_a_number_of_beams_that_is_set_and_not_in_the_log_is_named(tmp_path: Path) -> None:
    message = error_of(written(tmp_path, HEADER + flaser(ranges="1 2 3 4 5")))
    assert "found scans of 5 beams, allowed: 4 (laser.beams)" in message


@pytest.mark.parametrize("line", [odom(12.5), flaser(12.5)])
def test_a_last_line_cut_short_is_left_out_with_a_remark(tmp_path: Path, line: str) -> None:
    for length in range(1, line.rindex(" ") + 1):
        log = read_carmen(written(tmp_path, flaser() + line[:length]), LASER)
        assert len(log.ticks) == 1
        assert log.remarks()[0].startswith("the last line is damaged and left out (line 2: found ")
        assert "\n" not in log.remarks()[0]


@pytest.mark.parametrize("line", [odom(12.5), flaser(12.5)])
def test_the_same_damage_before_the_last_line_is_an_error(tmp_path: Path, line: str) -> None:
    for length in range(1, line.rindex(" ") + 1):
        assert "line 2: " in error_of(written(tmp_path, flaser() + line[:length] + "\n" + odom(13)))


def test_a_log_whose_only_scan_is_damaged_is_an_error(tmp_path: Path) -> None:
    assert "line 2: found FLASER" in error_of(written(tmp_path, odom() + flaser()[:20]))


def test_a_last_line_needs_no_line_end(tmp_path: Path) -> None:
    assert len(read_carmen(written(tmp_path, flaser() + flaser(2).rstrip("\n")), LASER).scans) == 2


def test_a_log_without_scans_lists_the_messages_it_has(tmp_path: Path) -> None:
    assert "found no FLASER or ROBOTLASER1 line (2 ODOM, 1 PARAM)" in error_of(
        written(tmp_path, HEADER + odom() + odom(2))
    )
    assert "no line at all" in error_of(written(tmp_path, ""))


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    assert "no such file" in error_of(tmp_path / "none.log")
    assert "cannot be read" in error_of(tmp_path)


def test_random_bytes_are_refused_in_one_short_line(tmp_path: Path) -> None:
    for seed in range(30):
        noise = np.random.default_rng(seed).bytes(5000)
        for start in (b"", b"\x1f\x8b\x08", b"BZh9", b"FLASER ", b"ODOM "):
            assert len(error_of(written(tmp_path, start + noise))) < 300 + len(str(tmp_path))


def test_an_endless_line_does_not_fill_the_memory(tmp_path: Path) -> None:
    assert "line 1: found a line of over" in error_of(written(tmp_path, gzip.compress(bytes(20_000_000))))


@pytest.mark.parametrize("compress", [gzip.compress, bz2.compress])
def test_a_truncated_compressed_log_is_refused(tmp_path: Path, compress) -> None:
    ranges = np.random.default_rng(0).uniform(0, 9, (40, 4)).round(3)
    content = compress("".join(flaser(i, " ".join(map(str, row))) for i, row in enumerate(ranges)).encode())
    for length in range(len(content) - 1, 3, -17):
        error_of(written(tmp_path, content[:length], "a.log.gz"))
    damaged = bytearray(content)
    damaged[len(content) // 2] ^= 0xFF
    error_of(written(tmp_path, bytes(damaged)))


def test_an_unknown_kind_of_log_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"allowed: CARMEN \(\.log, \.clf, \.carmen"):
        open_log(written(tmp_path, flaser(), "log.txt"), LASER)
    with pytest.raises(LogError, match="no such file"):
        open_log(tmp_path / "nothing", LASER)
    for name in ("a.b.CARMEN", "x.clf", "y.log"):
        assert len(open_log(written(tmp_path, flaser(), name), LASER).scans) == 1


def test_comments_and_blank_lines_of_relations_are_skipped(tmp_path: Path) -> None:
    text = "# checked\n\n1.5 2.5 0.1 0.2 9 9 9 4.0\n2.5 1.5 -0.1 0 0 0 0 -1\n"
    relations = read_relations(written(tmp_path, text, "a.relations"))
    assert relations.stamps.tolist() == [[1.5, 2.5], [2.5, 1.5]]
    assert relations.poses == pytest.approx(np.array([[0.1, 0.2, 4.0 - 2 * math.pi], [-0.1, 0.0, -1.0]]))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2 3 4 5 6 7 8\n1 2 3\n", "line 2: found 3 fields, allowed: 8"),
        ("1 2 3 4 5 6 7 x\n", "line 1: found 'x', allowed: a number"),
        ("1 2 nan 4 5 6 7 8\n", "line 1: found 'nan', allowed: a finite number"),
        ("# nothing\n", "found no relation"),
    ],
)
def test_bad_relations_are_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(LogError) as caught:
        read_relations(written(tmp_path, text, "a.relations"))
    assert said in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_the_intel_log_is_read_completely_and_in_its_order(data_dir: Path) -> None:
    log = open_log(data_dir / "intel" / "intel.clf.bz2")
    assert len(log.scans) == 13_631
    assert len(log.ticks) == 13_631 + 26_915
    assert log.backward_stamps == 631
    assert log.duration_s == pytest.approx(2691.29, abs=0.02)
    at_scans = np.array([tick.odometry.position for tick in log.ticks if tick.scan is not None])
    assert np.linalg.norm(np.diff(at_scans, axis=0), axis=1).sum() == pytest.approx(508.0, abs=1.0)
    relations = read_relations(data_dir / "intel" / "intel.relations")
    assert relations.stamps.shape == (2984, 2)
    assert set(relations.stamps.ravel()) <= {tick.log_stamp_s for tick in log.ticks}
