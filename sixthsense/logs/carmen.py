"""Logs of CARMEN, the robot navigation toolkit: text with one line per odometry record or laser scan."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, time_increment
from sixthsense.logs.finding import Finding
from sixthsense.logs.joining import Odometry, Sighting
from sixthsense.logs.laser_geometry import (
    FARTHEST_M,
    MOST_BEAMS,
    Beams,
    beams_as_stated,
    beams_by_count,
    beams_over,
    max_range_of,
    mount_from_poses,
    no_return_code,
)
from sixthsense.logs.log import Log
from sixthsense.logs.stamps import ascending, unit_of
from sixthsense.logs.text_lines import LARGEST, Record, records, shown

FLASER, ROBOTLASER, ODOM = b"FLASER", b"ROBOTLASER1", b"ODOM"
MESSAGES = (
    ROBOTLASER, FLASER, ODOM, b"PARAM", b"SYNC", b"RLASER", b"ROBOTLASER2", b"RAWLASER1", b"TRUEPOS", b"MARKER"
)  # fmt: skip
"""with which a log may begin"""
_FIELDS = {ODOM: (1, 9), FLASER: (2, 9), ROBOTLASER: (9, 14)}
"""number of fields before the ranges and after them, which begin with the poses:
ODOM / x y theta tv rv accel ipc_time host logger_time
FLASER n / x y theta odom_x odom_y odom_theta ipc_time host logger_time
ROBOTLASER1 type start_angle fov resolution max_range accuracy remission_mode n / x y theta odom_x odom_y odom_theta tv
rv front side axis ipc_time host logger_time, in most logs after a number of remissions and these"""
_SAVED_RAD = 1e-5  # by which a field of view that was saved differs from that of the beams
_OFFSET, _MAX = b"robot_frontlaser_offset", b"robot_front_laser_max"
_MOST_DAMAGED = 1000
"""Lines without one that can be read, after which a file is none of this kind."""
_MESSAGE_NAME = re.compile(rb"[A-Z][A-Z0-9_-]{0,39}")


class _Reading(NamedTuple):
    """A line with odometry, and with a scan if it has ranges."""

    kind: bytes
    stamp_ns: int
    stamp_s: float
    poses: Array
    """(2, 3) `T_odom_laser` and `T_odom_robot`; the latter twice on a line that has no scan"""
    ranges: NDArray[np.float32]
    """(beams,) metres, or inf; -1 for one that is negative or no number"""
    beams: Beams | None
    """as the line states them; a FLASER line does not"""
    max_range: float
    """metres, as the line states it; inf where it does not"""


@dataclass(slots=True)
class _Lines:
    """What the lines of a file say."""

    readings: list[_Reading] = field(default_factory=list)
    """in the order of the file"""
    kinds: Counter[bytes] = field(default_factory=Counter)
    """number of lines of each message"""
    params: dict[bytes, float] = field(default_factory=dict)
    """values of the parameters that describe the laser, m"""
    refused: list[str] = field(default_factory=list)
    """what is wrong with lines that are left out"""
    unit: tuple[int, str] | None = None
    """parts of a second, and their name, that stamps are in, by the first one"""


def read_carmen(file: str | Path, laser: LaserConfig | None = None) -> Log:
    """Read a CARMEN log: plain or compressed, recognised by the first bytes.

    The scans are those of the FLASER or of the ROBOTLASER1 lines, whichever are more. Other messages, as those of a
    rear laser, are skipped. The lines say the number of beams, their directions (a FLASER line by its number of beams,
    see `beams_by_count`), the laser's mount on the robot (the difference of the two poses of a line) and its maximum
    range (as stated, or the value that beams without a return repeat). A field of `laser` that was stated takes
    precedence.

    Ranges at or beyond the maximum, negative ones and those that are no number are no returns. Each scan has the beams
    and the maximum range of its own line. Damaged lines are left out and counted. Ticks keep the order of the file:
    each has the stamp of its record, or 1 ns after the previous tick if that is later. Stamps that would be of a far
    future in seconds are in a part of a second. Raises InputError for a file that cannot be read, is no CARMEN log, or
    has no scan.
    """
    path, given = Path(file), laser or LaserConfig()
    content = _read_lines(path)
    kind = max((ROBOTLASER, FLASER), key=lambda each: content.kinds[each])
    readings = [reading for reading in content.readings if reading.kind in (ODOM, kind)]
    scans = [reading for reading in readings if len(reading.ranges)]
    if not scans:
        there = (
            ", ".join(f"{count} {name.decode()}" for name, count in content.kinds.most_common(5)) or "no line at all"
        )
        raise InputError(path, f"found no FLASER or ROBOTLASER1 line ({there})", "a log with laser scans")
    found = _found(content, readings)
    mount = _mount(scans, given, content.params.get(_OFFSET, 0.0), found)
    reaches = _reaches(scans, given, content.params.get(_MAX, 0.0), found)
    stamps = ascending([reading.stamp_ns for reading in readings])
    odometry = Odometry(stamps, np.array([reading.poses[1] for reading in readings]))
    made = [
        Sighting(stamp_ns, _scan(reading, reaches[reading.max_range], given, mount), reading.stamp_s)
        for reading, stamp_ns in zip(readings, stamps.tolist(), strict=True)
        if len(reading.ranges)
    ]
    counts = {len(reading.ranges) for reading in scans}
    is_open = kind == FLASER and "fov" not in given.model_fields_set and len(counts) == 1
    return Log.of(made, odometry, given, found, beams_by_count(max(counts)) if is_open else ())


def _found(content: _Lines, readings: Sequence[_Reading]) -> list[Finding]:
    """What is odd in the lines of a file."""
    unmeasured = sum(int(np.count_nonzero(reading.ranges < 0.0)) for reading in readings)
    left_out = {
        "ranges that are negative or no number are no returns": unmeasured,
        "scans of the other of FLASER and ROBOTLASER1 are left out": len(content.readings) - len(readings),
        f"lines are left out, the first: {''.join(content.refused[:1])}": len(content.refused),
    }
    found = [Finding("left_out", count, place=place) for place, count in left_out.items() if count]
    if content.unit is not None and content.unit[0] > 1:
        found.append(Finding("stamps_unit", place=content.unit[1]))
    return found


def _mount(scans: Sequence[_Reading], given: LaserConfig, ahead_m: float, found: list[Finding]) -> Pose:
    """As stated, as both poses of the lines have it, or as a parameter has it."""
    if "mount" in given.model_fields_set:
        return Pose(*given.mount)
    place = mount_from_poses(*np.stack([reading.poses for reading in scans], axis=1))
    if place is not None:
        return place
    where = f"{ahead_m:g} m ahead of the robot's centre ({_OFFSET.decode()})" if ahead_m else "the robot's centre"
    why = "since its poses do not move as one body with the robot's"
    found.append(Finding("assumed_mount", place=f"{where}, {why}"))
    return Pose(ahead_m, 0.0, 0.0)


def _reaches(
    scans: Sequence[_Reading], given: LaserConfig, parameter: float, found: list[Finding]
) -> dict[float, float]:
    """Maximum ranges by those that lines state, m: as the user or the lines state, as codes, as a parameter says."""
    reaches: dict[float, float] = {}
    for stated in {reading.max_range for reading in scans}:
        if "max_range" in given.model_fields_set:
            reaches[stated] = given.max_range
            continue
        ranges = [reading.ranges for reading in scans if reading.max_range == stated]
        known = parameter if stated == math.inf and parameter > 0.0 else stated
        code = no_return_code(ranges)
        if code is not None and code < stated:
            found.append(Finding("assumed_range", code, place="since many beams repeat such a value"))
            known = code
        reaches[stated] = min(known, FARTHEST_M) if known < math.inf else max_range_of(ranges)
    return reaches


def _scan(reading: _Reading, reach: float, given: LaserConfig, mount: Pose) -> Scan:
    """The scan of a line, with its own beams unless the user has stated others."""
    count = len(reading.ranges)
    beams = reading.beams or beams_by_count(count)[0]
    if "fov" in given.model_fields_set and abs(given.fov - beams.step * (count - 1)) > _SAVED_RAD:
        beams = beams_over(given.fov, count)  # else it is that of a saved configuration
    is_return = (reading.ranges >= 0.0) & (reading.ranges < np.float32(reach))
    ranges = np.where(is_return, reading.ranges, np.float32(np.inf))
    ranges.flags.writeable = False
    scan = Scan(ranges, np.float32(beams.first), np.float32(beams.step), reach, mount, time_increment(given))
    return scan.mirrored() if given.mirrored else scan


def _read_lines(path: Path) -> _Lines:
    """Parse the lines of a file; those that are damaged are left out.

    Raises InputError for a file that cannot be read, and for one whose lines are all damaged.
    """
    content = _Lines()
    for count, record in enumerate(records(path), 1):
        try:
            _take(content, record)
        except InputError as error:
            content.refused.append(str(error.at(error.where.removeprefix(f"{path} "))))
            if len(content.refused) == count >= _MOST_DAMAGED:
                break
    if content.refused and not any(len(reading.ranges) for reading in content.readings):
        raise InputError("", f"{path} {content.refused[0]}")
    return content


def _take(content: _Lines, record: Record) -> None:
    """Add what a line says; InputError for one that is damaged."""
    fields, kind = record.fields, record.fields[0]
    if kind in _FIELDS:
        content.readings.append(_reading(record, content))
    elif not _MESSAGE_NAME.fullmatch(kind):
        record.fail(f"found {shown(kind)}, allowed: a CARMEN message, as ODOM or FLASER")
    elif any(name.startswith(kind) for name in _FIELDS):
        record.fail(f"found {shown(kind)}, a CARMEN line cut short")
    elif kind == b"PARAM" and len(fields) > 2 and fields[1] in (_OFFSET, _MAX):
        content.params[fields[1]] = float(record.numbers(fields[2:3])[0])
    content.kinds[kind] += 1


def _reading(record: Record, content: _Lines) -> _Reading:
    """The odometry and the scan of a line; remissions between ranges and poses, which some logs have, are skipped."""
    fields, kind = record.fields, record.fields[0]
    head, tail = _FIELDS[kind]
    count = 0
    if kind != ODOM:
        if len(fields) < head:
            record.fail(f"found {len(fields)} fields, a CARMEN line cut short")
        count = record.whole(head - 1, "number of values")
        if not 2 <= count <= MOST_BEAMS:
            record.fail(f"found {count} ranges, allowed: 2 to {MOST_BEAMS}")
    expected = head + count + tail
    if kind == ROBOTLASER and len(fields) > expected:
        expected += 1 + record.whole(head + count, "number of values")
    if len(fields) != expected:
        cut = " (a CARMEN line cut short)" * (len(fields) < expected)
        record.fail(f"found {kind.decode()} of {len(fields)} fields, allowed: {expected}{cut}")
    first, size = len(fields) - tail, 3 if kind == ODOM else 6
    poses = record.numbers(fields[first : first + size]).reshape(-1, 3)
    ranges = record.parsed(fields[head : head + count])
    ranges[ranges > LARGEST] = np.inf  # these may overflow a float32
    beams, reach = _stated(record, count) if kind == ROBOTLASER else (None, math.inf)
    content.unit = content.unit or unit_of(record.parsed(fields[-3:-2]))
    parts = content.unit[0]
    return _Reading(
        kind, record.stamp_ns(fields[-3], parts), float(fields[-3]) / parts, poses[[0, -1]],
        np.where(ranges >= 0.0, ranges, -1.0).astype(np.float32), beams, reach,
    )  # fmt: skip


def _stated(record: Record, count: int) -> tuple[Beams | None, float]:
    """The beams and the maximum range that a ROBOTLASER1 line states."""
    start, fov, resolution, max_range = record.numbers(record.fields[2:6])
    if not (abs(start) <= 2.0 * math.pi and 0.0 <= fov <= 2.0 * math.pi + 0.1):
        what = f"angles of {start:.6g} to {start + fov:.6g}{', which are degrees' if fov > 2.0 * math.pi else ''}"
        record.fail(f"found {what}, allowed: radians of up to a full circle")
    beams = beams_as_stated(count, start, fov, resolution) if fov > 0.0 else None
    return beams, max_range if max_range > 0.0 else math.inf
