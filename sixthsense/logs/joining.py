"""Joining the scans and the odometry of a bag: ticks in order, also where one begins or ends without the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Tick, seconds
from sixthsense.logs.clocks import MIRRORED, are_mirrored, clock_offset_s, least_s
from sixthsense.logs.log import longest_s, pose_between
from sixthsense.logs.stamps import passed_s, shown_span

_Row = tuple[int, Pose | None, dict[str, Any]]
"""stamp and odometry of a tick, and what it has of a scan"""

_AGREE_S = 1.0  # by which the offset by times of recording differs from that by turns: what messages take


class Stamped(NamedTuple):
    """A scan or a pose of odometry, with its times."""

    own_ns: int
    """stamp that puts it in order: that of its header, or of its recording"""
    record_ns: int
    """time of its recording"""
    place: int
    """in the order of the file"""
    value: Pose | Scan
    """`T_odom_robot`, or the scan"""

    @property
    def end_ns(self) -> int:
        """Stamp of the last beam of a scan; that of a pose."""
        if isinstance(self.value, Pose):
            return self.own_ns
        return self.own_ns - sweep_ns(len(self.value.ranges), self.value.time_increment)


def one_clock(
    scans: Sequence[Stamped], odometry: Sequence[Stamped], remarks: list[str]
) -> tuple[list[Stamped], list[Stamped]]:
    """Scans and odometry with stamps of one clock; a line on what was set right is added to the remarks.

    If their clocks differ by a constant, scans are set back by what the times of recording say of it, if these are
    farther from the stamps of scans; odometry is set right by the rest. Raises ValueError for two that share no time,
    and no turns that would tell by how much they differ.
    """
    stamps = np.array([each.own_ns for each in odometry], dtype=np.int64)
    headings = np.array([each.value.theta for each in odometry if isinstance(each.value, Pose)])
    seen = [(each.own_ns, each.value) for each in scans if isinstance(each.value, Scan)]
    offset_s = clock_offset_s(seen, stamps, headings)
    if not offset_s:
        if offset_s is None and are_mirrored(seen, stamps, headings):
            remarks.append(MIRRORED)
        if scans[0].own_ns > stamps[-1] or scans[-1].own_ns < stamps[0]:
            spans = shown_span([each.own_ns for each in scans]), shown_span(stamps)
            raise ValueError(f"found scans from {spans[0]}, odometry from {spans[1]}, allowed: one clock")
        return list(scans), list(odometry)
    delays_s = [seconds(float(np.median([each.record_ns - each.own_ns for each in of]))) for of in (scans, odometry)]
    by_record_s = delays_s[1] - delays_s[0]
    is_of_scans = abs(delays_s[0]) > abs(delays_s[1]) and abs(offset_s - by_record_s) < _AGREE_S
    back_s = by_record_s if is_of_scans else 0.0
    ahead_s = offset_s - back_s if abs(offset_s - back_s) >= least_s(stamps) else 0.0
    shifts = (("scans", -back_s), ("odometry", ahead_s))
    moved = " and ".join(
        f"those of {name} {'ahead' if by_s > 0.0 else 'back'} by {abs(by_s):.2f} s" for name, by_s in shifts if by_s
    )
    lead = "lead" if offset_s > 0.0 else "lag behind"
    remarks.append(
        f"scans {lead} odometry by {abs(offset_s):.2f} s, by the turns that both see (other clocks?): stamps are set "
        f"right, {moved}"
    )
    return _shifted(scans, -back_s), _shifted(odometry, ahead_s)


def _shifted(stamped: Sequence[Stamped], by_s: float) -> list[Stamped]:
    by_ns = round(1e9 * by_s)
    return [each._replace(own_ns=each.own_ns + by_ns) for each in stamped]


def joined(
    scans: Sequence[Stamped], odometry: Sequence[Stamped], own_s: Sequence[float], by_stamps: bool, remarks: list[str]
) -> list[Tick]:
    """One tick per scan and per pose, and one for both with the same stamp; at least 1 ns apart.

    They are sorted by their stamps, or keep the order of the file; `own_s` are the log's stamps of the scans. The
    odometry of a scan is interpolated at its stamp. Scans before and after all odometry, and in a long pause during
    which it has moved, have none: they go on alone, and odometry after them goes on from there. Lines that say when are
    added to the remarks.
    """
    entries = sorted(
        [(each, own) for each, own in zip(scans, own_s, strict=True)] + [(each, 0.0) for each in odometry],
        key=(lambda e: (e[0].end_ns, isinstance(e[0].value, Scan))) if by_stamps else (lambda e: e[0].place),
    )
    known = _Known(odometry, by_stamps)
    rows: list[_Row] = []
    last, since = -1, 0
    for each, own in entries:
        if isinstance(each.value, Pose):
            last, since = last + 1, 0
            rows.append((each.own_ns, each.value, {}))
            continue
        seen = {"scan": each.value, "log_stamp_s": own}
        if rows and not rows[-1][2] and each.end_ns == odometry[last].own_ns:
            rows[-1][2].update(seen)
            continue
        pose = known.at(each.end_ns) if by_stamps else known.after(last, since)
        rows.append((each.end_ns, pose, seen))
        since += 1
    ticks, alone = _held(rows, known.poses[0])
    remarks += _times_alone(ticks, alone)
    return ticks


def _held(rows: Sequence[_Row], first: Pose) -> tuple[list[Tick], list[int]]:
    """Ticks, and the rows of those whose scans have no odometry.

    They keep the pose of the tick before, or have the `first` at the beginning. Odometry goes on from there.
    """
    ticks: list[Tick] = []
    alone: list[int] = []
    T_held, is_alone = Pose(), False
    for stamp_ns, T_odom_robot, seen in rows:
        held = ticks[-1].odometry if ticks else first
        if T_odom_robot is None:
            alone.append(len(ticks))
        elif is_alone:
            T_held = held @ T_odom_robot.inverse()
        pose = held if T_odom_robot is None else T_held @ T_odom_robot
        at_ns = max(stamp_ns, ticks[-1].stamp_ns + 1) if ticks else stamp_ns
        ticks.append(Tick(at_ns, pose, is_unmeasured=T_odom_robot is None or is_alone, **seen))
        is_alone = T_odom_robot is None
    return ticks, alone


class _Known:
    """Odometry at a stamp, where it is known."""

    def __init__(self, odometry: Sequence[Stamped], by_stamps: bool) -> None:
        self.stamps_ns: NDArray[np.int64] = np.array([each.own_ns for each in odometry], dtype=np.int64)
        self.poses = [each.value for each in odometry if isinstance(each.value, Pose)]
        usual_s = float(np.median(passed_s(self.stamps_ns))) if by_stamps and len(odometry) > 1 else 0.0
        self._usual_ns, self._longest_ns = round(1e9 * usual_s), round(1e9 * longest_s(usual_s))

    def at(self, at_ns: int) -> Pose | None:
        """`T_odom_robot` at a stamp; None a period before the first and after the last, and in a long pause."""
        row = int(np.searchsorted(self.stamps_ns, at_ns, side="right")) - 1
        if row < 0:
            return self.poses[0] if self.stamps_ns[0] - at_ns <= self._usual_ns else None
        before_ns, before = int(self.stamps_ns[row]), self.poses[row]
        if row + 1 == len(self.poses):
            return before if at_ns - before_ns <= self._usual_ns else None
        after_ns, after = int(self.stamps_ns[row + 1]), self.poses[row + 1]
        if before_ns == at_ns or before == after:
            return before
        if after_ns - before_ns > self._longest_ns:
            return None
        return pose_between((before_ns, before), (after_ns, after), at_ns)

    def after(self, last: int, since: int) -> Pose | None:
        """The same by the order of the file: at scan number `since` after pose `last`."""
        if last < 0 or (last + 1 == len(self.poses) and since > 0):
            return None
        return self.poses[last]


def _times_alone(ticks: Sequence[Tick], alone: Sequence[int]) -> list[str]:
    """A line on the scans that have no odometry, if there are more than a moment's."""
    rows = np.array(alone, dtype=np.int64)
    if not len(rows):
        return []
    stamps_s = 1e-9 * np.array([tick.stamp_ns - ticks[0].stamp_ns for tick in ticks])
    spans = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    lines = []
    for span in spans:
        if len(span) == 1:
            continue  # a scan that ends after the last odometry, of any bag
        begin_s, end_s = stamps_s[span[0]], stamps_s[span[-1]]
        when = "at the beginning" if span[0] == 0 else "at the end" if span[-1] == len(ticks) - 1 else "in a pause"
        lines.append(f"{begin_s:.1f} to {end_s:.1f} s ({len(span)} scans, {when})")
    if not lines:
        return []
    shown = ", ".join(lines[:4]) + f" and {len(lines) - 4} more" * (len(lines) > 4)
    return [f"no odometry from {shown}: these scans go on alone, each predicted by the last velocity"]
