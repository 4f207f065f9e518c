"""CARMEN logs: one text line per odometry record or laser scan."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose, interpolated
from sixthsense.core.laser import Scan, time_increment
from sixthsense.core.source import Tick
from sixthsense.logs.clocks import MIRRORED
from sixthsense.logs.field_of_view import FIELDS_RAD, seen_ratio
from sixthsense.logs.laser_geometry import (
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
from sixthsense.logs.log import Log, without_jumps
from sixthsense.logs.refused import Refused
from sixthsense.logs.stamps import from_zero_on, passed_s, unit_of
from sixthsense.logs.text_lines import LARGEST, Record, records, shown
from sixthsense.logs.units import SI, Units, check_bearings, check_odometry, check_ranges

FLASER, ROBOTLASER, RAWLASER, ODOM = b"FLASER", b"ROBOTLASER1", b"RAWLASER1", b"ODOM"
_SCANS = (ROBOTLASER, FLASER, RAWLASER)
MESSAGES = (*_SCANS, ODOM, b"PARAM", b"SYNC", b"RLASER", b"ROBOTLASER2", b"RAWLASER2", b"TRUEPOS", b"MARKER")
"""with which a log may begin"""
_ODOM_FIELDS = 10
"""ODOM x y theta tv rv accel ipc_time host logger_time"""
_FLASER_FIELDS = 11
"""FLASER n (here the n ranges) x y theta odom_x odom_y odom_theta ipc_time host logger_time"""
_ROBOTLASER_HEAD = 9
"""ROBOTLASER1 type start_angle fov resolution max_range accuracy remission_mode n, before the n ranges"""
_ROBOTLASER_TAIL = 14
"""x y theta odom_x odom_y odom_theta tv rv front side axis ipc_time host logger_time, after the m remissions"""
_RAWLASER_TAIL = 3
"""ipc_time host logger_time, after the m remissions; before these as in ROBOTLASER1"""
_PARAMS = (b"robot_frontlaser_offset", b"robot_front_laser_max")
_MOST_DAMAGED = 1000
"""Lines without one that can be read, after which a file is none of this kind."""
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
    """(2, 3) `T_odom_laser` and `T_odom_robot`; the latter twice on a line that has no scan or states no pose"""
    geometry: _Geometry | None
    ranges: NDArray[np.float32]
    """(beams,) metres, at least 0, or inf"""


@dataclass(slots=True)
class _Lines:
    """What the lines of a file say."""

    units: Units = SI
    """of the numbers of the file"""
    readings: list[_Reading] = field(default_factory=list)
    """in the order of the file"""
    kinds: Counter[bytes] = field(default_factory=Counter)
    """number of lines of each message"""
    params: dict[bytes, float] = field(default_factory=dict)
    """values of the parameters that describe the laser, m"""
    unmeasured: int = 0  # ranges that are negative or no number
    stamps: tuple[int, str] | None = None
    """parts of a second, and their name, that stamps are in, by the first one"""


def read_carmen(file: str | Path, laser: LaserConfig | None = None, units: Units = SI) -> Log:
    """Read a CARMEN log: plain or compressed, recognised by the first bytes.

    The scans are those of the FLASER or of the ROBOTLASER1 lines, whichever are more, ROBOTLASER1 if they are as many;
    without either, those of the RAWLASER1 lines, with odometry interpolated at their stamps. Other messages, as those
    of a rear laser, are skipped. The lines say the number of beams, their directions (a FLASER line by its number of
    beams, see `beams_by_count`, and by the turns that odometry sees, too), the laser's mount on the robot (the
    difference of the two poses of a line) and its maximum range (as stated, or the value that beams without a return
    repeat). A field of `laser` that was stated takes precedence.

    Ranges at or beyond the maximum, negative ones and those that are no number are no returns. Each scan has the beams
    and the maximum range of its own line. Damaged lines are left out and counted. Ticks keep the order of the file:
    each has the stamp of its record, or 1 ns after the previous tick if that is later; stamps below 0 are moved. Stamps
    that would be of a far future in seconds are in a part of a second. Raises
    InputError for a file that cannot be read, is no CARMEN log, is in other `units`, or has no scan with a return.
    """
    path, given = Path(file), laser or LaserConfig()
    names = given.explicit_fields
    remarks: list[str] = []
    content = _read_lines(path, units, remarks)
    kind = _kind_of_scans(path, content, remarks)
    remarks += [f"{content.unmeasured} ranges that are negative or no number are no returns"] * (content.unmeasured > 0)
    content.readings = [r for r in content.readings if r.geometry is None or r.kind == kind]
    has_odometry = kind != RAWLASER or content.kinds[ODOM] > 0
    if kind == RAWLASER and has_odometry:
        content.readings = _with_odometry(content.readings)
    geometries = _geometries(path, content.readings, given.beams if "beams" in names else None, remarks)
    scans = [r for r in content.readings if r.geometry in geometries]
    check_ranges(str(path), [reading.ranges for reading in scans])
    _check_odometry(path, content.readings)
    place = Pose(*given.mount) if "mount" in names else _mount(kind, scans, content, remarks)
    reach = given.max_range if "max_range" in names else None
    lasers = _lasers(scans, geometries, given.fov if "fov" in names else None, reach, content, remarks)
    lasers = _by_turns(scans, lasers, given, remarks)
    reach_of: dict[_Geometry | None, float] = {geometry: each.reach for geometry, each in lasers.items()}
    if not any(((r.ranges > 0.0) & (r.ranges < np.float32(reach_of[r.geometry]))).any() for r in scans):
        allowed = f"ranges above 0 and below {max(reach_of.values()):g} m"
        raise InputError(path, f"found no return in {len(scans)} scans", allowed)
    most = lasers[geometries[0]]
    known = described(given, geometries[0].beams, most.beams.step, most.reach, place)
    ticks = _ticks(content.readings, lasers, known, remarks)
    ticks = list(without_jumps(ticks, [r.stamp_ns for r in content.readings], remarks))
    return Log(ticks, known, remarks, has_odometry)


def _kind_of_scans(path: Path, content: _Lines, remarks: list[str]) -> bytes:
    """The message whose lines are the scans; InputError if the log has none of them."""
    kinds = content.kinds
    if not any(kinds[kind] for kind in _SCANS):
        counts = (f"{count} {kind.decode()}" for kind, count in kinds.most_common(5) if count)
        found = ", ".join(counts) or "no line at all"
        raise InputError(path, f"found no FLASER, ROBOTLASER1 or RAWLASER1 line ({found})", "a log with laser scans")
    kind = max((kind for kind in _SCANS[:2] if kinds[kind]), key=lambda kind: kinds[kind], default=RAWLASER)
    if kinds[FLASER] and kinds[ROBOTLASER]:
        both = f"found {kinds[FLASER]} FLASER and {kinds[ROBOTLASER]} ROBOTLASER1 lines"
        remarks.append(f"{both}; the scans are those of {kind.decode()}")
    return kind


def _geometries(path: Path, readings: Sequence[_Reading], count: int | None, remarks: list[str]) -> list[_Geometry]:
    """The geometries of the scans, the most frequent first; with a stated number of beams only those with it."""
    found = Counter(reading.geometry for reading in readings if reading.geometry is not None)
    wanted = range(2, MOST_BEAMS + 1) if count is None else (count,)
    fitting = {geometry: scans for geometry, scans in found.items() if geometry.beams in wanted}
    if not fitting:
        counts = ", ".join(str(n) for n in sorted({geometry.beams for geometry in found}))
        allowed = f"2 to {MOST_BEAMS}" if count is None else f"{count} (laser.beams)"
        raise InputError(path, f"found scans of {counts} beams", allowed)
    others = found.total() - sum(fitting.values())
    if others:
        beams = ", ".join(str(n) for n in sorted({geometry.beams for geometry in found if geometry not in fitting}))
        remarks.append(f"{others} scans of another geometry ({beams} beams) are left out")
    return sorted(fitting, key=lambda geometry: -fitting[geometry])


class _Laser(NamedTuple):
    """What the scans of a geometry are of."""

    beams: Beams
    reach: float
    """maximum range, m"""


def _lasers(
    scans: Sequence[_Reading],
    geometries: Sequence[_Geometry],
    fov: float | None,
    reach: float | None,
    content: _Lines,
    remarks: list[str],
) -> dict[_Geometry, _Laser]:
    """The laser of each geometry; `fov` and `reach` as the user has stated them."""
    reaches: dict[float, float] = {}
    for geometry in geometries:
        if geometry.max_range not in reaches:
            own = [r for r in scans if r.geometry is not None and r.geometry.max_range == geometry.max_range]
            found = _max_range(own, geometry.max_range, content, remarks) if reach is None else reach
            reaches[geometry.max_range] = found
    return {each: _Laser(_beams(each, fov), reaches[each.max_range]) for each in geometries}


def _check_odometry(path: Path, readings: Sequence[_Reading]) -> None:
    poses = np.array([reading.poses[1] for reading in readings])
    check_odometry(str(path), passed_s([reading.stamp_ns for reading in readings]), poses)


def _beams(geometry: _Geometry, fov: float | None) -> Beams:
    count = geometry.beams
    if geometry.fov > 0.0:
        beams = beams_as_stated(count, geometry.start, geometry.fov, geometry.resolution)
    else:
        beams = beams_by_count(count)
    if fov is not None and abs(fov - beams.step * (count - 1)) > 1e-9:  # else it is that of a saved configuration
        return beams_over(fov, count)
    return beams


def _by_turns(
    scans: Sequence[_Reading], lasers: Mapping[_Geometry, _Laser], given: LaserConfig, remarks: list[str]
) -> dict[_Geometry, _Laser]:
    """The lasers with the beams that fit the turns of odometry, where nobody states them; remarks on what is assumed.

    Scans that turn the other way round are told, and not mirrored: odometry may be as wrong.
    """
    out = dict(lasers)
    for geometry, (beams, reach) in lasers.items():
        own = [reading for reading in scans if reading.geometry == geometry]
        is_stated = geometry.fov > 0.0 or "fov" in given.explicit_fields
        fields = (math.pi,) if is_stated else FIELDS_RAD
        side = -1.0 if given.mirrored else 1.0
        ratios = [sign * field / math.pi for sign in (side, -side) for field in fields]
        made = [Scan(r.ranges, np.float32(beams.first), np.float32(beams.step), reach) for r in own]
        ratio = seen_ratio(made, np.array([reading.poses[1] for reading in own]), ratios)
        if ratio is not None and ratio * side < 0.0:
            remarks.append(MIRRORED)
        if is_stated:
            continue
        if ratio is not None:
            out[geometry] = _Laser(beams_by_count(geometry.beams, abs(ratio) * math.pi), reach)
        first, step = (math.degrees(angle) for angle in out[geometry].beams)
        by = "" if ratio is None else ", by the turns that odometry and scans see"
        remarks.append(
            f"assumed: {geometry.beams} beams from {first:g} to {first + step * (geometry.beams - 1):g} degrees{by}, "
            "since a FLASER line does not say their directions (otherwise set `laser.fov`)"
        )
    return out


def _mount(kind: bytes, scans: Sequence[_Reading], content: _Lines, remarks: list[str]) -> Pose:
    place = None if kind == RAWLASER else mount_from_poses(*np.stack([r.poses for r in scans], axis=1))
    if place is not None:
        return place
    ahead_m = content.params.get(b"robot_frontlaser_offset", 0.0)
    where = f"{ahead_m:g} m ahead of the robot's centre (robot_frontlaser_offset)" if ahead_m else "the robot's centre"
    why = (
        "RAWLASER1 lines do not state it" if kind == RAWLASER else "its poses do not move as one body with the robot's"
    )
    remarks.append(f"assumed: the laser at {where}, since {why} (otherwise set `laser.mount`)")
    return Pose(ahead_m, 0.0, 0.0)


def _with_odometry(readings: Sequence[_Reading]) -> list[_Reading]:
    """The readings with odometry at the scans: interpolated at their stamps, or of the line before where these repeat.

    Scans before the first odometry have that.
    """
    rows = [row for row, reading in enumerate(readings) if reading.geometry is None]
    stamps = np.array([readings[row].stamp_s for row in rows])
    poses = np.array([readings[row].poses[1] for row in rows])
    if np.all(np.diff(stamps) > 0.0):
        found = interpolated(stamps, poses, np.array([reading.stamp_s for reading in readings]))
    else:
        found = poses[np.maximum(np.searchsorted(rows, np.arange(len(readings)), side="right") - 1, 0)]
    return [
        reading if reading.geometry is None else reading._replace(poses=np.tile(pose, (2, 1)))
        for reading, pose in zip(readings, found, strict=True)
    ]


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


def _ticks(
    readings: Sequence[_Reading], lasers: Mapping[_Geometry, _Laser], given: LaserConfig, remarks: list[str]
) -> list[Tick]:
    """A tick per line, with a scan where the line has one of these geometries."""
    ticks: list[Tick] = []
    place, lag = Pose(*given.mount), time_increment(given)
    stamps = from_zero_on(np.array([reading.stamp_ns for reading in readings], dtype=np.int64), remarks)
    stamp_ns = -1
    for reading, own_ns in zip(readings, stamps.tolist(), strict=True):
        scan = None
        if reading.geometry is not None and reading.geometry in lasers:
            (first, step), reach = lasers[reading.geometry]
            ranges = np.where(reading.ranges < np.float32(reach), reading.ranges, np.float32(np.inf))
            ranges.flags.writeable = False
            scan = Scan(ranges, np.float32(first), np.float32(step), reach, place, lag)
            scan = scan.mirrored() if given.mirrored else scan
        stamp_ns = max(own_ns, stamp_ns + 1)
        own_s = None if scan is None else reading.stamp_s
        ticks.append(Tick(stamp_ns, Pose.from_array(reading.poses[1]), scan, log_stamp_s=own_s))
    return ticks


def _read_lines(path: Path, units: Units, remarks: list[str]) -> _Lines:
    """Parse the lines of a file; those that are damaged are left out, and counted in a remark.

    Raises InputError for a file that cannot be read, and for one whose lines are all damaged.
    """
    content, refused, count, last = _Lines(units), Refused(), 0, 0
    for record in records(path):
        count += 1
        try:
            _take(content, record)
        except InputError as error:
            last = count
            refused.add("lines", error.at(error.where.removeprefix(f"{path} ")))
            if refused.count("lines") == count >= _MOST_DAMAGED:
                break
    if content.stamps is not None and content.stamps[0] > 1:
        first_s = content.readings[0].stamp_s
        remarks.append(f"stamps are taken as {content.stamps[1]} since 1970: the first as {first_s:.6f} s")
    damaged = refused.count("lines")
    if damaged and not any(reading.geometry is not None for reading in content.readings):
        raise InputError("", f"{path} {refused.first('lines')}")
    if damaged == 1 and last == count:
        remarks.append(f"the last line is damaged and left out ({refused.first('lines')})")
    elif damaged:
        remarks += refused.remarks({"lines": count}, "lines")
    return content


def _take(content: _Lines, record: Record) -> None:
    fields, kind = record.fields, record.fields[0]
    read = {FLASER: _flaser, ROBOTLASER: _robotlaser, RAWLASER: _rawlaser, ODOM: _odom}.get(kind)
    if read is not None:
        scan = read(record, content.units)  # which checks the number of fields
        content.unmeasured += int(np.count_nonzero(scan[2] < 0.0))
        scan[2][scan[2] < 0.0] = np.inf
        stamp = fields[-3]
        parts, unit = content.stamps or unit_of(record.parsed([stamp]))
        content.readings.append(_Reading(kind, record.stamp_ns(stamp, parts), float(stamp) / parts, *scan))
        content.stamps = parts, unit
    elif not _MESSAGE_NAME.fullmatch(kind):
        record.fail(f"found {shown(kind)}, allowed: a CARMEN message, as ODOM or FLASER")
    elif any(name.startswith(kind) for name in (*_SCANS, ODOM)):
        record.fail(f"found {shown(kind)}, a CARMEN line cut short")
    elif kind == b"PARAM" and len(fields) > 2 and fields[1] in _PARAMS:
        content.params[fields[1]] = float(record.numbers(fields[2:3])[0])
    content.kinds[kind] += 1


_Line = tuple[Array, _Geometry | None, NDArray[np.float32]]
"""poses and scan, as in a `_Reading`"""


def _odom(record: Record, units: Units) -> _Line:
    _expect(record, _ODOM_FIELDS)
    return np.tile(_poses(record, 1, 4, units), (2, 1)), None, np.zeros(0, dtype=np.float32)


def _flaser(record: Record, units: Units) -> _Line:
    count = _count(record, 1)
    _expect(record, count + _FLASER_FIELDS, f" with {count} ranges")
    return _poses(record, -9, -3, units), _Geometry(count), _ranges(record, 2, count, units)


def _poses(record: Record, first: int, past: int, units: Units) -> Array:
    """(n, 3) poses in fields, m and rad."""
    scale = (units.odometry, units.odometry, units.headings)
    return np.asarray(record.numbers(record.fields[first:past]).reshape(-1, 3) * scale)


def _robotlaser(record: Record, units: Units) -> _Line:
    return _poses(record, -14, -8, units), *_stated_scan(record, units, _ROBOTLASER_TAIL)


def _rawlaser(record: Record, units: Units) -> _Line:
    return np.zeros((2, 3)), *_stated_scan(record, units, _RAWLASER_TAIL)


def _stated_scan(record: Record, units: Units, tail: int) -> tuple[_Geometry, NDArray[np.float32]]:
    """A scan that states its beams, with its remissions or, as CARMEN's own description of the format has it, without.

    `tail` is the number of fields behind these.
    """
    count = _count(record, _ROBOTLASER_HEAD - 1)
    if len(record.fields) != _ROBOTLASER_HEAD + count + tail:
        remissions = _count(record, _ROBOTLASER_HEAD + count, "remissions")
        expected = _ROBOTLASER_HEAD + count + 1 + remissions + tail
        _expect(record, expected, f" with {count} ranges and {remissions} remissions")
    start, fov, resolution, max_range = record.numbers(record.fields[2:6])
    start, fov, resolution = (units.angles * value for value in (start, fov, resolution))
    max_range *= units.ranges
    try:
        check_bearings(start, start + fov)
    except ValueError as error:
        record.fail(str(error))
    if not (abs(start) <= 2.0 * math.pi and 0.0 <= fov <= 2.0 * math.pi + 0.1):
        record.fail(f"found start angle {start:g} and field of view {fov:g}, allowed: radians of up to a full circle")
    geometry = _Geometry(count, start, fov, resolution, max_range if max_range > 0.0 else math.inf)
    return geometry, _ranges(record, _ROBOTLASER_HEAD, count, units)


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


def _ranges(record: Record, first: int, count: int, units: Units) -> NDArray[np.float32]:
    """(count,) metres, or inf, from field `first` on; -1 for one that is negative or no number."""
    if count < 2:
        record.fail(f"found {count} ranges, allowed: 2 to {MOST_BEAMS}")
    values = units.ranges * record.parsed(record.fields[first : first + count])
    values[values > LARGEST] = np.inf  # these may overflow a float32
    return np.where(values >= 0.0, values, -1.0).astype(np.float32)
