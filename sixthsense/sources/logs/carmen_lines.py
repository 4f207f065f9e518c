"""Lines of a CARMEN log: odometry, scans, and the parameters of the laser."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.text_lines import LARGEST, Record, records, shown

FLASER, ROBOTLASER, ODOM = b"FLASER", b"ROBOTLASER1", b"ODOM"
_ODOM_FIELDS = 10
"""ODOM x y theta tv rv accel ipc_time host logger_time"""
_FLASER_FIELDS = 11
"""FLASER n (here the n ranges) x y theta odom_x odom_y odom_theta ipc_time host logger_time"""
_ROBOTLASER_HEAD = 9
"""ROBOTLASER1 type start_angle fov resolution max_range accuracy remission_mode n, before the n ranges"""
_ROBOTLASER_TAIL = 14
"""x y theta odom_x odom_y odom_theta tv rv front side axis ipc_time host logger_time, after the m remissions"""
_PARAMS = (b"robot_frontlaser_offset", b"robot_front_laser_max")
_MESSAGE_NAME = re.compile(rb"[A-Z][A-Z0-9_-]{0,39}")


class Geometry(NamedTuple):
    """What a line says of its laser; a FLASER line says the number of beams alone."""

    beams: int
    """number of beams"""
    start: float = 0.0
    """bearing of the first beam, rad"""
    fov: float = 0.0
    """field of view, rad; 0: not stated"""
    resolution: float = 0.0
    """between two beams, rad; 0: not stated"""
    max_range: float = math.inf
    """metres"""


class Reading(NamedTuple):
    """A line with odometry, and with a scan if it has a geometry."""

    kind: bytes
    stamp_ns: int
    stamp_s: float
    robot: Array
    """(3,) `T_odom_robot`"""
    laser: Array
    """(3,) `T_odom_laser`; that of the robot on a line without a scan"""
    geometry: Geometry | None
    ranges: NDArray[np.float32]
    """(beams,) metres, at least 0, or inf"""


@dataclass(slots=True)
class CarmenLines:
    """What the lines of a file say."""

    readings: list[Reading] = field(default_factory=list)
    """in the order of the file"""
    kinds: Counter[bytes] = field(default_factory=Counter)
    """number of lines of each message"""
    params: dict[bytes, float] = field(default_factory=dict)
    """values of the parameters that describe the laser, m"""
    damage: str = ""
    """what is wrong with the last line, if anything"""


def read_lines(path: Path) -> CarmenLines:
    """Parse the lines of a file; a last line that is damaged is left out if a scan comes before it.

    Raises LogError for a file that cannot be read or is not a CARMEN log, and for damage before the last line.
    """
    content = CarmenLines()
    damaged: LogError | None = None
    for record in records(path):
        if damaged is not None:
            raise damaged
        try:
            _take(content, record)
        except LogError as error:
            damaged = error
    if damaged is not None:
        if not any(reading.geometry is not None for reading in content.readings):
            raise damaged
        content.damage = str(damaged).removeprefix(f"{path} ")
    return content


def _take(content: CarmenLines, record: Record) -> None:
    fields, kind = record.fields, record.fields[0]
    if kind == FLASER:
        content.readings.append(_flaser(record))
    elif kind == ROBOTLASER:
        content.readings.append(_robotlaser(record))
    elif kind == ODOM:
        _expect(record, _ODOM_FIELDS)
        robot = record.numbers(fields[1:4])
        content.readings.append(_reading(record, robot, robot, None, np.zeros(0, dtype=np.float32)))
    elif not _MESSAGE_NAME.fullmatch(kind):
        record.fail(f"found {shown(kind)}, allowed: a CARMEN message, as ODOM or FLASER")
    elif any(name.startswith(kind) for name in (FLASER, ROBOTLASER, ODOM)):
        record.fail(f"found {shown(kind)}, a CARMEN line cut short")
    elif kind == b"PARAM" and len(fields) > 2 and fields[1] in _PARAMS:
        content.params[fields[1]] = float(record.numbers(fields[2:3])[0])
    content.kinds[kind] += 1


def _flaser(record: Record) -> Reading:
    count = _count(record, 1)
    _expect(record, count + _FLASER_FIELDS, f" with {count} ranges")
    poses = record.numbers(record.fields[-9:-3])
    return _reading(record, poses[3:], poses[:3], Geometry(count), _ranges(record, 2, count))


def _robotlaser(record: Record) -> Reading:
    """A ROBOTLASER1 line, with its remissions or, as CARMEN's own description of the format has it, without."""
    fields = record.fields
    count = _count(record, _ROBOTLASER_HEAD - 1)
    tail = fields[_ROBOTLASER_HEAD + count :]
    if len(tail) != _ROBOTLASER_TAIL:
        remissions = _count(record, _ROBOTLASER_HEAD + count, "remissions")
        expected = _ROBOTLASER_HEAD + count + 1 + remissions + _ROBOTLASER_TAIL
        _expect(record, expected, f" with {count} ranges and {remissions} remissions")
    start, fov, resolution, max_range = record.numbers(fields[2:6])
    if not (abs(start) <= 2.0 * math.pi and 0.0 <= fov <= 2.0 * math.pi + 0.1):
        record.fail(f"found start angle {start:g} and field of view {fov:g}, allowed: radians of up to a full circle")
    geometry = Geometry(count, start, fov, resolution, max_range if max_range > 0.0 else math.inf)
    poses = record.numbers(fields[-14:-8])
    return _reading(record, poses[3:], poses[:3], geometry, _ranges(record, _ROBOTLASER_HEAD, count))


def _reading(
    record: Record, robot: Array, laser: Array, geometry: Geometry | None, ranges: NDArray[np.float32]
) -> Reading:
    stamp = record.fields[-3]
    return Reading(record.fields[0], record.stamp_ns(stamp), float(stamp), robot, laser, geometry, ranges)


def _count(record: Record, place: int, what: str = "ranges") -> int:
    """The number of ranges, or of remissions, in a field."""
    kind = record.fields[0].decode()
    if len(record.fields) <= place:
        record.fail(f"found {kind} without {what}, a CARMEN line cut short")
    return record.whole(place, f"number of {what}")


def _expect(record: Record, count: int, what: str = "") -> None:
    kind = record.fields[0].decode() + what
    if len(record.fields) < count:
        record.fail(f"found {kind} of {len(record.fields)} fields, allowed: {count} (a CARMEN line cut short)")
    if len(record.fields) > count:
        record.fail(f"found {kind} of {len(record.fields)} fields, allowed: {count}")


def _ranges(record: Record, first: int, count: int) -> NDArray[np.float32]:
    """(count,) metres, at least 0, or inf, from field `first` on."""
    values = record.parsed(record.fields[first : first + count])
    bad = np.flatnonzero(~(values >= 0.0))
    if len(bad):
        record.fail(f"found range {shown(record.fields[first + bad[0]])}, allowed: metres, at least 0")
    values[values > LARGEST] = np.inf  # these may overflow a float32
    return values.astype(np.float32)
