"""CARMEN logs: one text line per odometry record or laser scan."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, time_increment
from sixthsense.core.source import Tick
from sixthsense.sources.logs.carmen_lines import FLASER, ROBOTLASER, CarmenLines, Geometry, Reading, read_lines
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.laser_geometry import (
    LARGEST_RANGE_M,
    Beams,
    beams_as_stated,
    beams_by_count,
    beams_over,
    max_range_of,
    mount_from_poses,
    no_return_code,
)
from sixthsense.sources.logs.log import Log

_MOST_BEAMS = 100_000


def read_carmen(file: str | Path, laser: LaserConfig | None = None, stated: Collection[str] = ()) -> Log:
    """Read a CARMEN log: plain, gzip or bzip2, recognised by the first bytes.

    The scans are those of the FLASER or of the ROBOTLASER1 lines, whichever are more, ROBOTLASER1 if they are as many;
    other messages, as those of a rear laser, are skipped. The lines say the number of beams, their directions (a
    FLASER line by its number of beams, see `beams_by_count`), the laser's mount on the robot (the difference of the
    two poses of a line) and its maximum range (as stated, or the value that beams without a return repeat). A field of
    `laser` that is named in `stated`, or differs from the default of LaserConfig, takes precedence.

    Ranges at or beyond the maximum are no returns. Scans of another geometry than that of most are left out, as is a
    damaged last line. Ticks keep the order of the file: each has the stamp of its record, or 1 ns after the previous
    tick if that is later. Raises LogError for a file that cannot be read or is damaged before its last line, that is
    not a CARMEN log, or has no scan with a return.
    """
    path, given, default = Path(file), laser or LaserConfig(), LaserConfig()
    names = {f.name for f in dataclasses.fields(LaserConfig) if getattr(given, f.name) != getattr(default, f.name)}
    names |= set(stated)
    content = read_lines(path)
    remarks = [f"the last line is damaged and left out ({content.damage})"] if content.damage else []
    kind = _kind_of_scans(path, content, remarks)
    content.readings = [r for r in content.readings if r.geometry is None or r.kind == kind]
    geometry = _geometry(path, content.readings, given.beams if "beams" in names else None, remarks)
    scans = [r for r in content.readings if r.geometry == geometry]
    beams = _beams(geometry, given.fov if "fov" in names else None, remarks)
    place = Pose(*given.mount) if "mount" in names else _mount(scans, content, remarks)
    reach = given.max_range if "max_range" in names else _max_range(scans, content, remarks)
    if not any(((reading.ranges > 0.0) & (reading.ranges < np.float32(reach))).any() for reading in scans):
        allowed = f"allowed: ranges above 0 and below {reach:g} m"
        raise LogError(f"{path}: found no return in {len(scans)} scans, {allowed}")
    described = _described(given, geometry.beams, beams, place, reach)
    return Log(_ticks(content.readings, geometry, beams, described), described, remarks)


def _kind_of_scans(path: Path, content: CarmenLines, remarks: list[str]) -> bytes:
    """The message whose lines are the scans; LogError if the log has neither."""
    kinds = content.kinds
    if not kinds[FLASER] and not kinds[ROBOTLASER]:
        found = ", ".join(f"{count} {kind.decode()}" for kind, count in kinds.most_common(5) if count)
        found = found or "no line at all"
        raise LogError(f"{path}: found no FLASER or ROBOTLASER1 line ({found}), allowed: a log with laser scans")
    kind = FLASER if kinds[FLASER] > kinds[ROBOTLASER] else ROBOTLASER
    if kinds[FLASER] and kinds[ROBOTLASER]:
        remarks.append(
            f"found {kinds[FLASER]} FLASER and {kinds[ROBOTLASER]} ROBOTLASER1 lines; the scans are those of "
            f"{kind.decode()}"
        )
    return kind


def _geometry(path: Path, readings: Sequence[Reading], count: int | None, remarks: list[str]) -> Geometry:
    """The geometry of most scans, or of those with a stated number of beams; the other scans are left out."""
    found = Counter(reading.geometry for reading in readings if reading.geometry is not None)
    wanted = range(2, _MOST_BEAMS + 1) if count is None else (count,)
    fitting = {geometry: scans for geometry, scans in found.items() if geometry.beams in wanted}
    if not fitting:
        counts = ", ".join(str(n) for n in sorted({geometry.beams for geometry in found}))
        allowed = f"2 to {_MOST_BEAMS}" if count is None else f"{count} (laser.beams)"
        raise LogError(f"{path}: found scans of {counts} beams, allowed: {allowed}")
    chosen = max(fitting, key=lambda geometry: fitting[geometry])
    others = found.total() - found[chosen]
    if others:
        beams = ", ".join(str(n) for n in sorted({geometry.beams for geometry in found if geometry != chosen}))
        remarks.append(f"{others} scans of another geometry ({beams} beams) are left out")
    return chosen


def _beams(geometry: Geometry, fov: float | None, remarks: list[str]) -> Beams:
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


def _mount(scans: Sequence[Reading], content: CarmenLines, remarks: list[str]) -> Pose:
    laser, robot = np.stack([r.laser for r in scans]), np.stack([r.robot for r in scans])
    place = mount_from_poses(laser, robot)
    if place is not None:
        return place
    ahead_m = content.params.get(b"robot_frontlaser_offset", 0.0)
    where = f"{ahead_m:g} m ahead of the robot's centre (robot_frontlaser_offset)" if ahead_m else "the robot's centre"
    remarks.append(
        f"assumed: the laser at {where}, since its poses do not move as one body with the robot's (otherwise set "
        "laser.mount)"
    )
    return Pose(ahead_m, 0.0, 0.0)


def _max_range(scans: Sequence[Reading], content: CarmenLines, remarks: list[str]) -> float:
    """Metres: as the lines state, as the repeated code for no return, as a parameter says, else above all ranges."""
    ranges = [reading.ranges for reading in scans]
    geometry = scans[0].geometry
    stated = math.inf if geometry is None else geometry.max_range
    code = no_return_code(ranges)
    if code is not None and code < stated:
        remarks.append(f"assumed: ranges from {code:.2f} m on are no returns, since many beams repeat such a value")
        return min(code, LARGEST_RANGE_M)
    parameter = content.params.get(b"robot_front_laser_max", 0.0)
    if stated == math.inf and parameter > 0.0:
        stated = parameter
    return min(stated, LARGEST_RANGE_M) if stated < math.inf else max_range_of(ranges)


def _described(given: LaserConfig, count: int, beams: Beams, place: Pose, reach: float) -> LaserConfig:
    """The laser as a configuration, in which the field of view is centred on the mount's x axis."""
    closed = abs(beams.step * count - 2.0 * math.pi) < 0.5 * beams.step
    fov = 2.0 * math.pi if closed else min(beams.step * (count - 1), 2.0 * math.pi)
    return dataclasses.replace(given, beams=count, fov=fov, max_range=reach, mount=(place.x, place.y, place.theta))


def _ticks(readings: Sequence[Reading], geometry: Geometry, beams: Beams, laser: LaserConfig) -> list[Tick]:
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
        ticks.append(Tick(stamp_ns, Pose.from_array(reading.robot), scan, log_stamp_s=own_s))
    return ticks
