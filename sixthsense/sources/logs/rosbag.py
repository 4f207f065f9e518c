"""ROS 1 and ROS 2 bags with laser scans and odometry."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Tick
from sixthsense.sources.logs.bag_file import opened
from sixthsense.sources.logs.bag_recording import BagOptions, Recording, read_recording
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.laser_geometry import max_range_of
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.oddities import found_turns
from sixthsense.sources.logs.ros_messages import FARTHEST_M, scan


def read_bag(
    file: str | Path, laser: LaserConfig, options: BagOptions | None = None, is_mount_given: bool = False
) -> Log:
    """Read a bag: ROS 1 (.bag), or ROS 2 (a folder with metadata.yaml, an .mcap or a .db3 file).

    Scans and odometry are the topics of type LaserScan and Odometry; `options.topics` selects among several. Without a
    topic of Odometry, or with `options.frames`, odometry is a pair of frames in /tf; without transforms there, the log
    has scans alone, as with `options.odometry` off. Beams and ranges come from the messages. The mount is `laser.mount`
    if it is not zero or `is_mount_given`, else that of /tf_static. Scans of another frame than the first are left out.
    Messages are sorted by the stamps of their headers if the stamps of each topic ascend, else they keep the order of
    the file. The stamp of a tick is at least 1 ns after the previous one. The odometry of a scan is interpolated at its
    stamp. The stamp of a sweep is that of its first beam in the message and of its last beam in the tick.
    Raises LogError for a bag that cannot be read, is damaged or truncated, or lacks a topic of scans.
    """
    path = Path(file)
    with opened(path) as reader:
        return _log(path, read_recording(path, reader, options or BagOptions()), laser, is_mount_given)


def _log(path: Path, recording: Recording, laser: LaserConfig, is_mount_given: bool) -> Log:
    if not recording.scans or not recording.odometry:
        missing = "LaserScan" if not recording.scans else "Odometry"
        raise LogError(f"{path}: found a topic of {missing} without a message, allowed: a log with scans and odometry")
    place, upside_down = _mount(path, recording, laser, is_mount_given)
    max_range = _max_range(recording)
    scans = []
    for number, (_, message) in enumerate(recording.scans, start=1):
        try:
            scans.append(scan(message, place, upside_down, max_range))
        except ValueError as error:
            raise LogError(f"{path} scan {number}: {error}") from None
    if not any((s.ranges <= np.float32(s.max_range)).any() for s in scans):
        raise LogError(f"{path}: found no return in {len(scans)} scans, allowed: ranges from range_min to range_max")
    if turns := found_turns(scans, recording.laser):
        raise LogError(f"{path}: {turns}")
    for frame, count in recording.other_frames.items():
        recording.remarks.append(
            f"{count} scans of {shown_name(frame)} are left out, since those of {shown_name(recording.laser)} "
            "are of another laser"
        )
    ticks = _ticks(path, recording, scans)
    return Log(ticks, described_laser(scans[0], laser), recording.remarks, recording.has_odometry)


def _mount(path: Path, recording: Recording, laser: LaserConfig, is_given: bool) -> tuple[Pose, bool]:
    """The mount of the laser on the robot, and whether the laser is upside down."""
    try:
        found = recording.tree.mount(recording.robot, recording.laser)
    except ValueError as error:
        raise LogError(f"{path} /tf_static: {error}") from None
    place, upside_down = found or (Pose(), False)
    if is_given or any(laser.mount):
        return Pose(*laser.mount), upside_down
    if found is None and recording.has_odometry:
        frames = f"{shown_name(recording.robot)} to {shown_name(recording.laser)}"
        recording.remarks.append(
            f"assumed: the laser at the robot's centre, since no /tf_static leads from {frames} "
            "(otherwise set laser.mount)"
        )
    return place, upside_down


def _max_range(recording: Recording) -> float | None:
    """Metres, by the ranges themselves where the first message has no plausible `range_max`; None where it has one."""
    if not float(recording.scans[0][1].range_max) > FARTHEST_M:
        return None
    ranges = [np.asarray(message.ranges, dtype=np.float32) for _, message in recording.scans]
    found = max_range_of(ranges)
    recording.remarks.append(f"assumed: a laser of {found:.2f} m, since range_max is not the range of a laser")
    return found


def described_laser(first: Scan, laser: LaserConfig) -> LaserConfig:
    """The configuration of the laser that took a scan."""
    step, count = float(first.angle_increment), len(first.ranges)
    fov = 2.0 * math.pi if first.closed else min(step * (count - 1), 2.0 * math.pi)
    place = first.T_robot_laser
    return replace(laser, beams=count, fov=fov, max_range=first.max_range, mount=(place.x, place.y, place.theta))


def _ticks(path: Path, recording: Recording, scans: Sequence[Scan]) -> list[Tick]:
    """One tick per message, and one for odometry and scan with the same stamp, from the first odometry on."""
    odometry = recording.odometry

    ends = [own - sweep_ns(len(s.ranges), s.time_increment) for (own, _), s in zip(recording.scans, scans, strict=True)]

    def stamp(entry: tuple[bool, int]) -> int:
        return ends[entry[1]] if entry[0] else odometry[entry[1]][0]

    order = recording.order
    if _ascends(recording.scans) and _ascends(odometry):
        if recording.scans[0][0] > odometry[-1][0] or recording.scans[-1][0] < odometry[0][0]:
            spans = [f"{s[0][0] * 1e-9:.3f} to {s[-1][0] * 1e-9:.3f} s" for s in (recording.scans, odometry)]
            raise LogError(f"{path}: found scans from {spans[0]}, odometry from {spans[1]}, allowed: one clock")
        order = sorted(order, key=lambda entry: (stamp(entry), entry[0]))
    ticks: list[Tick] = []
    clock, last = -1, -1
    for entry in order:
        is_scan, number = entry
        own = stamp(entry)
        if not is_scan:
            last = number
        if last < 0:
            continue  # the pose of the robot is not known yet
        if is_scan:
            log_stamp_s = recording.scans[number][0] / 1e9
            if ticks and ticks[-1].scan is None and own == odometry[last][0]:
                ticks[-1] = replace(ticks[-1], scan=scans[number], log_stamp_s=log_stamp_s)
                continue
            clock = max(own, clock + 1)
            pose = _interpolate(odometry, last, own)
            ticks.append(Tick(clock, pose, scans[number], log_stamp_s=log_stamp_s))
        else:
            clock = max(own, clock + 1)
            ticks.append(Tick(clock, odometry[number][1]))
    if not any(tick.scan is not None for tick in ticks):
        raise LogError(f"{path}: found no scan after the first odometry, allowed: a log with both")
    return ticks


def _ascends(stamped: Sequence[tuple[int, Any]]) -> bool:
    return all(a[0] <= b[0] for a, b in itertools.pairwise(stamped))


def _interpolate(odometry: Sequence[tuple[int, Pose]], last: int, at_ns: int) -> Pose:
    """Odometry interpolated at a stamp between message `last` and the next; that of `last` for any other stamp."""
    before_ns, before = odometry[last]
    after_ns, after = odometry[min(last + 1, len(odometry) - 1)]
    if not before_ns < at_ns < after_ns:
        return before
    motion, share = before.inverse() @ after, (at_ns - before_ns) / (after_ns - before_ns)
    return before @ Pose(share * motion.x, share * motion.y, share * motion.theta)
