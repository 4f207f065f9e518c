"""Logs of CARMEN, the robot navigation toolkit: text with one line per odometry record or laser scan."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, time_increment
from sixthsense.logs import laser_geometry as geometry
from sixthsense.logs.finding import Finding
from sixthsense.logs.log import Log, Odometry, Sighting, ascending
from sixthsense.logs.text_lines import LARGEST, Record, records

FLASER, ROBOTLASER, ODOM = b"FLASER", b"ROBOTLASER1", b"ODOM"
MESSAGES = (ROBOTLASER, FLASER, ODOM, b"PARAM", b"SYNC", b"RLASER", b"ROBOTLASER2", b"RAWLASER1", b"TRUEPOS", b"MARKER")
"""with which a log may begin"""
_FIELDS = {ODOM: (1, 9), FLASER: (2, 9), ROBOTLASER: (9, 14)}
"""number of fields before the ranges and after them, which begin with the poses:
ODOM / x y theta tv rv accel ipc_time host logger_time
FLASER n / x y theta odom_x odom_y odom_theta ipc_time host logger_time
ROBOTLASER1 type start_angle fov resolution max_range accuracy remission_mode n / x y theta odom_x odom_y odom_theta tv
rv front side axis ipc_time host logger_time, in most logs after a number of remissions and these"""
_SAVED_RAD = 1e-5  # by which a field of view that was saved differs from that of the beams
_OFFSET, _MAX = b"robot_frontlaser_offset", b"robot_front_laser_max"


class _Reading(NamedTuple):
    """A line with odometry, and with a scan if it has ranges."""

    kind: bytes
    stamp_ns: int
    stamp_s: float
    poses: Array
    """(2, 3) `T_odom_laser` and `T_odom_robot`; the latter twice on a line that has no scan"""
    ranges: NDArray[np.float32]
    """(beams,) metres; inf for one that is negative or no number"""
    beams: geometry.Beams | None
    """as the line states them; a FLASER line does not"""
    max_range: float
    """metres, as the line states it; inf where it does not"""


def read_carmen(file: str | Path, laser: LaserConfig | None = None) -> Log:
    """Read a CARMEN log: plain or compressed, recognised by the first bytes.

    The scans are those of the FLASER or of the ROBOTLASER1 lines, whichever are more. Other messages, as those of a
    rear laser, are skipped. The lines say the number of beams, their directions (a FLASER line by its number of beams,
    see `beams_by_count`), the laser's mount on the robot (the difference of the two poses of a line) and its maximum
    range (as stated, or the value that beams without a return repeat). A field of `laser` that was stated takes
    precedence.

    Ranges at or beyond the maximum, negative ones and those that are no number are no returns. Each scan has the beams
    and the maximum range of its own line. Damaged lines are left out and counted. Ticks keep the order of the file:
    each has the stamp of its record, or 1 ns after the previous tick if that is later. Raises InputError for a file
    that cannot be read, is no CARMEN log, or has no scan.
    """
    path, given = Path(file), laser or LaserConfig()
    lines: list[_Reading] = []
    kinds: Counter[bytes] = Counter()
    params, refused = {_OFFSET: 0.0, _MAX: 0.0}, []
    for record in records(path):
        fields, kind = record.fields, record.fields[0]
        kinds[kind] += 1
        try:
            if kind in _FIELDS:
                lines.append(_reading(record))
            elif kind == b"PARAM" and len(fields) > 2 and fields[1] in params:
                params[fields[1]] = float(record.numbers(fields[2:3])[0])
        except InputError as error:
            refused.append(str(error.at(error.where.removeprefix(f"{path} "))))
    kind = max((ROBOTLASER, FLASER), key=lambda each: kinds[each])
    readings = [reading for reading in lines if reading.kind in (ODOM, kind)]
    scans = [reading for reading in readings if len(reading.ranges)]
    if not scans:
        there = ", ".join(f"{n} {name.decode(errors='replace')[:20]}" for name, n in kinds.most_common(5))
        none = f"found no FLASER or ROBOTLASER1 line ({there})"
        raise InputError(path, refused[0]) if refused else InputError(path, none, "a log with laser scans")
    left_out = {
        "scans of the other of FLASER and ROBOTLASER1 are left out": len(lines) - len(readings),
        f"lines are left out, the first: {''.join(refused[:1])}": len(refused),
    }
    found = [Finding("left_out", count, place=place) for place, count in left_out.items() if count]
    mount = _mount(scans, given, params[_OFFSET], found)
    reaches = {
        stated: _reach(stated, [each.ranges for each in scans if each.max_range == stated], given, params[_MAX], found)
        for stated in {reading.max_range for reading in scans}
    }
    stamps = ascending([reading.stamp_ns for reading in readings])
    odometry = Odometry(stamps, np.array([reading.poses[1] for reading in readings]))
    made = [
        Sighting(stamp_ns, _scan(reading, reaches[reading.max_range], given, mount), reading.stamp_s)
        for reading, stamp_ns in zip(readings, stamps.tolist(), strict=True)
        if len(reading.ranges)
    ]
    is_open = kind == FLASER and "fov" not in given.model_fields_set and len({len(each.ranges) for each in scans}) == 1
    return Log.of(made, odometry, given, found, geometry.beams_by_count(len(scans[0].ranges)) if is_open else ())


def _reading(record: Record) -> _Reading:
    """The odometry and the scan of a line; remissions between ranges and poses, which some logs have, are skipped."""
    fields, kind = record.fields, record.fields[0]
    head, tail = _FIELDS[kind]
    count = record.whole(head - 1, "number of values") if kind != ODOM and len(fields) >= head else 0
    expected = head + count + tail
    if kind == ROBOTLASER and len(fields) > expected:
        expected += 1 + record.whole(head + count, "number of values")
    if len(fields) != expected or not 2 * (kind != ODOM) <= count <= geometry.MOST_BEAMS:
        cut = " (a CARMEN line cut short)" * (len(fields) < expected)
        record.fail(f"found {kind.decode()} of {count} ranges and {len(fields)} fields, allowed: {expected}{cut}")
    poses = record.numbers(fields[-tail : 3 - tail if kind == ODOM else 6 - tail]).reshape(-1, 3)
    ranges = record.numbers(fields[head : head + count], None) if count else np.zeros(0)
    seen = np.where((ranges >= 0.0) & (ranges <= LARGEST), ranges, np.inf).astype(np.float32)
    beams, reach = _stated(record, count) if kind == ROBOTLASER else (None, math.inf)
    return _Reading(kind, record.stamp_ns(fields[-3]), float(fields[-3]), poses[[0, -1]], seen, beams, reach)


def _stated(record: Record, count: int) -> tuple[geometry.Beams | None, float]:
    """The beams and the maximum range that a ROBOTLASER1 line states; its field of view overrides its resolution."""
    start, fov, resolution, max_range = record.numbers(record.fields[2:6]).tolist()
    if not (abs(start) <= 2.0 * math.pi and 0.0 <= fov <= 2.0 * math.pi + 0.1):
        what = f"angles of {start:.6g} to {start + fov:.6g}{', which are degrees' if fov > 2.0 * math.pi else ''}"
        record.fail(f"found {what}, allowed: radians of up to a full circle")
    agrees = resolution > 0.0 and abs(resolution * (count - 1) - fov) <= 1.5 * resolution
    beams = geometry.Beams(start, resolution if agrees else geometry.beams_over(fov, count).step) if fov > 0.0 else None
    return beams, max_range if max_range > 0.0 else math.inf


def _mount(scans: Sequence[_Reading], given: LaserConfig, ahead_m: float, found: list[Finding]) -> Pose:
    """As stated, as both poses of the lines have it, or as a parameter has it."""
    if "mount" in given.model_fields_set:
        return Pose(*given.mount)
    place = geometry.mount_from_poses(*np.stack([reading.poses for reading in scans], axis=1))
    if place is None:
        where = f"{ahead_m:g} m ahead of the robot's centre ({_OFFSET.decode()})" if ahead_m else "the robot's centre"
        found.append(Finding("assumed_mount", place=f"{where}, since its poses do not move as one body with the robot"))
    return place or Pose(ahead_m, 0.0, 0.0)


def _reach(
    stated: float, ranges: Sequence[NDArray[np.float32]], given: LaserConfig, parameter: float, found: list[Finding]
) -> float:
    """The maximum range of scans, m: as the user states, as codes, as the lines state, or as a parameter says."""
    if "max_range" in given.model_fields_set:
        return given.max_range
    code = geometry.no_return_code(ranges)
    if code is not None and code < stated:
        found.append(Finding("assumed_range", code, place="since many beams repeat such a value"))
        return min(code, geometry.FARTHEST_M)
    known = parameter if stated == math.inf and parameter > 0.0 else stated
    return min(known, geometry.FARTHEST_M) if known < math.inf else geometry.max_range_of(ranges)


def _scan(reading: _Reading, reach: float, given: LaserConfig, mount: Pose) -> Scan:
    """The scan of a line, with its own beams unless the user has stated others."""
    count = len(reading.ranges)
    beams = reading.beams or geometry.beams_by_count(count)[0]
    if "fov" in given.model_fields_set and abs(given.fov - beams.step * (count - 1)) > _SAVED_RAD:
        beams = geometry.beams_over(given.fov, count)  # else it is that of a saved configuration
    ranges = np.where(reading.ranges < np.float32(reach), reading.ranges, np.float32(np.inf))
    ranges.flags.writeable = False
    scan = Scan(ranges, np.float32(beams.first), np.float32(beams.step), reach, mount, time_increment(given))
    return scan.mirrored() if given.mirrored else scan
