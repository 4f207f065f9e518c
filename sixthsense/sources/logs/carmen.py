"""CARMEN logs: one text line per odometry record or laser scan."""

from __future__ import annotations

import dataclasses
import math
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, time_increment
from sixthsense.core.source import Tick
from sixthsense.sources.logs.laser_geometry import (
    FARTHEST_M,
    MOST_BEAMS,
    Beams,
    beams_as_stated,
    beams_by_count,
    beams_over,
    described,
    max_range_of,
    mount_from_poses,
    no_return_code,
)
from sixthsense.sources.logs.log import Log, without_jumps
from sixthsense.sources.logs.text_lines import LARGEST, LogError, Record, records, shown

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


class _Geometry(NamedTuple):
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


class _Reading(NamedTuple):
    """A line with odometry, and with a scan if it has a geometry."""

    kind: bytes
    stamp_ns: int
    stamp_s: float
    poses: Array
    """(2, 3) `T_odom_laser` and `T_odom_robot`; the latter twice on a line without a scan"""
    geometry: _Geometry | None
    ranges: NDArray[np.float32]
    """(beams,) metres, at least 0, or inf"""


@dataclass(slots=True)
class _Lines:
    """What the lines of a file say."""

    readings: list[_Reading] = field(default_factory=list)
    """in the order of the file"""
    kinds: Counter[bytes] = field(default_factory=Counter)
    """number of lines of each message"""
    params: dict[bytes, float] = field(default_factory=dict)
    """values of the parameters that describe the laser, m"""
    unmeasured: int = 0  # ranges that are negative or no number


def read_carmen(file: str | Path, laser: LaserConfig | None = None, stated: Collection[str] = ()) -> Log:
    """Read a CARMEN log: plain, gzip or bzip2, recognised by the first bytes.

    The scans are those of the FLASER or of the ROBOTLASER1 lines, whichever are more, ROBOTLASER1 if they are as many;
    other messages, as those of a rear laser, are skipped. The lines say the number of beams, their directions (a
    FLASER line by its number of beams, see `beams_by_count`), the laser's mount on the robot (the difference of the
    two poses of a line) and its maximum range (as stated, or the value that beams without a return repeat). A field of
    `laser` that is named in `stated`, or differs from the default of LaserConfig, takes precedence.

    Ranges at or beyond the maximum, negative ones and those that are no number are no returns. Scans of another
    geometry than that of most are left out, as is a damaged last line. Ticks keep the order of the file: each has the
    stamp of its record, or 1 ns after the previous tick if that is later. Raises LogError for a
    file that cannot be read or is damaged before its last line, is no CARMEN log, or has no scan with a return.
    """
    path, given, default = Path(file), laser or LaserConfig(), LaserConfig()
    names = {f.name for f in dataclasses.fields(LaserConfig) if getattr(given, f.name) != getattr(default, f.name)}
    names |= set(stated)
    remarks: list[str] = []
    content = _read_lines(path, remarks)
    kind = _kind_of_scans(path, content, remarks)
    remarks += [f"{content.unmeasured} ranges that are negative or no number are no returns"] * (content.unmeasured > 0)
    content.readings = [r for r in content.readings if r.geometry is None or r.kind == kind]
    geometry = _geometry(path, content.readings, given.beams if "beams" in names else None, remarks)
    scans = [r for r in content.readings if r.geometry == geometry]
    beams = _beams(geometry, given.fov if "fov" in names else None, remarks)
    place = Pose(*given.mount) if "mount" in names else _mount(scans, content, remarks)
    reach = given.max_range if "max_range" in names else _max_range(scans, geometry.max_range, content, remarks)
    if not any(((reading.ranges > 0.0) & (reading.ranges < np.float32(reach))).any() for reading in scans):
        allowed = f"allowed: ranges above 0 and below {reach:g} m"
        raise LogError(f"{path}: found no return in {len(scans)} scans, {allowed}")
    known = described(given, geometry.beams, beams.step, reach, place)
    return Log(without_jumps(_ticks(content.readings, geometry, beams, known), remarks), known, remarks)


def _kind_of_scans(path: Path, content: _Lines, remarks: list[str]) -> bytes:
    """The message whose lines are the scans; LogError if the log has neither."""
    kinds = content.kinds
    if not kinds[FLASER] and not kinds[ROBOTLASER]:
        counts = (f"{count} {kind.decode()}" for kind, count in kinds.most_common(5) if count)
        found = ", ".join(counts) or "no line at all"
        raise LogError(f"{path}: found no FLASER or ROBOTLASER1 line ({found}), allowed: a log with laser scans")
    kind = FLASER if kinds[FLASER] > kinds[ROBOTLASER] else ROBOTLASER
    if kinds[FLASER] and kinds[ROBOTLASER]:
        both = f"found {kinds[FLASER]} FLASER and {kinds[ROBOTLASER]} ROBOTLASER1 lines"
        remarks.append(f"{both}; the scans are those of {kind.decode()}")
    return kind


def _geometry(path: Path, readings: Sequence[_Reading], count: int | None, remarks: list[str]) -> _Geometry:
    """The geometry of most scans, or of those with a stated number of beams; the other scans are left out."""
    found = Counter(reading.geometry for reading in readings if reading.geometry is not None)
    wanted = range(2, MOST_BEAMS + 1) if count is None else (count,)
    fitting = {geometry: scans for geometry, scans in found.items() if geometry.beams in wanted}
    if not fitting:
        counts = ", ".join(str(n) for n in sorted({geometry.beams for geometry in found}))
        allowed = f"2 to {MOST_BEAMS}" if count is None else f"{count} (laser.beams)"
        raise LogError(f"{path}: found scans of {counts} beams, allowed: {allowed}")
    chosen = max(fitting, key=lambda geometry: fitting[geometry])
    others = found.total() - found[chosen]
    if others:
        beams = ", ".join(str(n) for n in sorted({geometry.beams for geometry in found if geometry != chosen}))
        remarks.append(f"{others} scans of another geometry ({beams} beams) are left out")
    return chosen


def _beams(geometry: _Geometry, fov: float | None, remarks: list[str]) -> Beams:
    count = geometry.beams
    if geometry.fov > 0.0:
        beams = beams_as_stated(count, geometry.start, geometry.fov, geometry.resolution)
    else:
        beams = beams_by_count(count)
    if fov is not None and abs(fov - beams.step * (count - 1)) > 1e-9:  # else it is that of a saved configuration
        return beams_over(fov, count)
    if geometry.fov <= 0.0 and fov is None:
        first, step = math.degrees(beams.first), math.degrees(beams.step)
        remarks.append(
            f"assumed: {count} beams from {first:g} to {first + step * (count - 1):g} degrees, since a FLASER line "
            "does not say their directions (otherwise set laser.fov)"
        )
    return beams


def _mount(scans: Sequence[_Reading], content: _Lines, remarks: list[str]) -> Pose:
    if (place := mount_from_poses(*np.stack([r.poses for r in scans], axis=1))) is not None:
        return place
    ahead_m = content.params.get(b"robot_frontlaser_offset", 0.0)
    where = f"{ahead_m:g} m ahead of the robot's centre (robot_frontlaser_offset)" if ahead_m else "the robot's centre"
    why = "since its poses do not move as one body with the robot's"
    remarks.append(f"assumed: the laser at {where}, {why} (otherwise set laser.mount)")
    return Pose(ahead_m, 0.0, 0.0)


def _max_range(scans: Sequence[_Reading], stated: float, content: _Lines, remarks: list[str]) -> float:
    """Metres: as the lines state, as the repeated code for no return, as a parameter says, else above all ranges."""
    ranges = [reading.ranges for reading in scans]
    code = no_return_code(ranges)
    if code is not None and code < stated:
        remarks.append(f"assumed: ranges from {code:.2f} m on are no returns, since many beams repeat such a value")
        return min(code, FARTHEST_M)
    parameter = content.params.get(b"robot_front_laser_max", 0.0)
    if stated == math.inf and parameter > 0.0:
        stated = parameter
    return min(stated, FARTHEST_M) if stated < math.inf else max_range_of(ranges)


def _ticks(readings: Sequence[_Reading], geometry: _Geometry, beams: Beams, laser: LaserConfig) -> list[Tick]:
    """A tick per line, with a scan where the line has that geometry."""
    ticks: list[Tick] = []
    place, lag = Pose(*laser.mount), time_increment(laser)
    first, step, farthest = np.float32(beams.first), np.float32(beams.step), np.float32(laser.max_range)
    stamp_ns = -1
    for reading in readings:
        scan = None
        if reading.geometry == geometry:
            ranges = np.where(reading.ranges < farthest, reading.ranges, np.float32(np.inf))
            ranges.flags.writeable = False
            scan = Scan(ranges, first, step, laser.max_range, place, lag)
        stamp_ns = max(reading.stamp_ns, stamp_ns + 1)
        own_s = None if scan is None else reading.stamp_s
        ticks.append(Tick(stamp_ns, Pose.from_array(reading.poses[1]), scan, log_stamp_s=own_s))
    return ticks


def _read_lines(path: Path, remarks: list[str]) -> _Lines:
    """Parse the lines of a file; a last line that is damaged is left out if a scan comes before it.

    Raises LogError for a file that cannot be read or is not a CARMEN log, and for damage before the last line.
    """
    content = _Lines()
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
        remarks.append(f"the last line is damaged and left out ({str(damaged).removeprefix(f'{path} ')})")
    return content


def _take(content: _Lines, record: Record) -> None:
    fields, kind = record.fields, record.fields[0]
    read = {FLASER: _flaser, ROBOTLASER: _robotlaser, ODOM: _odom}.get(kind)
    if read is not None:
        scan = read(record)  # which checks the number of fields
        content.unmeasured += int(np.count_nonzero(scan[2] < 0.0))
        scan[2][scan[2] < 0.0] = np.inf
        stamp = fields[-3]
        content.readings.append(_Reading(kind, record.stamp_ns(stamp), float(stamp), *scan))
    elif not _MESSAGE_NAME.fullmatch(kind):
        record.fail(f"found {shown(kind)}, allowed: a CARMEN message, as ODOM or FLASER")
    elif any(name.startswith(kind) for name in (FLASER, ROBOTLASER, ODOM)):
        record.fail(f"found {shown(kind)}, a CARMEN line cut short")
    elif kind == b"PARAM" and len(fields) > 2 and fields[1] in _PARAMS:
        content.params[fields[1]] = float(record.numbers(fields[2:3])[0])
    content.kinds[kind] += 1


_Line = tuple[Array, _Geometry | None, NDArray[np.float32]]
"""poses and scan, as in a `_Reading`"""


def _odom(record: Record) -> _Line:
    _expect(record, _ODOM_FIELDS)
    return np.tile(record.numbers(record.fields[1:4]), (2, 1)), None, np.zeros(0, dtype=np.float32)


def _flaser(record: Record) -> _Line:
    count = _count(record, 1)
    _expect(record, count + _FLASER_FIELDS, f" with {count} ranges")
    return record.numbers(record.fields[-9:-3]).reshape(2, 3), _Geometry(count), _ranges(record, 2, count)


def _robotlaser(record: Record) -> _Line:
    """A ROBOTLASER1 line, with its remissions or, as CARMEN's own description of the format has it, without."""
    count = _count(record, _ROBOTLASER_HEAD - 1)
    if len(record.fields) != _ROBOTLASER_HEAD + count + _ROBOTLASER_TAIL:
        remissions = _count(record, _ROBOTLASER_HEAD + count, "remissions")
        expected = _ROBOTLASER_HEAD + count + 1 + remissions + _ROBOTLASER_TAIL
        _expect(record, expected, f" with {count} ranges and {remissions} remissions")
    start, fov, resolution, max_range = record.numbers(record.fields[2:6])
    if not (abs(start) <= 2.0 * math.pi and 0.0 <= fov <= 2.0 * math.pi + 0.1):
        record.fail(f"found start angle {start:g} and field of view {fov:g}, allowed: radians of up to a full circle")
    geometry = _Geometry(count, start, fov, resolution, max_range if max_range > 0.0 else math.inf)
    poses = record.numbers(record.fields[-14:-8]).reshape(2, 3)
    return poses, geometry, _ranges(record, _ROBOTLASER_HEAD, count)


def _count(record: Record, place: int, what: str = "ranges") -> int:
    """The number of ranges, or of remissions, in a field."""
    if len(record.fields) <= place:
        record.fail(f"found {record.fields[0].decode()} without {what}, a CARMEN line cut short")
    return record.whole(place, f"number of {what}")


def _expect(record: Record, count: int, what: str = "") -> None:
    found = len(record.fields)
    if found != count:
        cut = " (a CARMEN line cut short)" * (found < count)
        record.fail(f"found {record.fields[0].decode()}{what} of {found} fields, allowed: {count}{cut}")


def _ranges(record: Record, first: int, count: int) -> NDArray[np.float32]:
    """(count,) metres, or inf, from field `first` on; -1 for one that is negative or no number."""
    values = record.parsed(record.fields[first : first + count])
    values[values > LARGEST] = np.inf  # these may overflow a float32
    return np.where(values >= 0.0, values, -1.0).astype(np.float32)
