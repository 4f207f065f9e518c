"""What a user should know of recorded messages: gaps and jumps of odometry, and two lasers that take turns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan

GAP_S = 0.5
"""No pose is interpolated in a longer gap of odometry."""
JOLT_M, JOLT_RAD = 0.5, 0.5
"""by which odometry may move at any moment, beside what the robot's speed allows"""
_FASTEST, _FASTEST_RAD = 5.0, 5.0  # m/s and rad/s of a robot on wheels in a building

_FEWEST, _MOST_TRIPLES = 6, 100  # scans, and triples of successive ones that are compared
_BINS = 36  # of bearings, around a full turn
_LEAST_M = 0.1  # difference of two views, below which noise and the robot's own motion may make it
_RATIO = 0.25
"""Of a scan's difference from the second next one, to that from the next: a laser that moves has at least about 1."""
_SHARE = 0.8  # of the triples


def remarks_on(odometry: Sequence[tuple[int, Pose]]) -> list[str]:
    """A line each on gaps and jumps of poses with stamps, ns, in the order of the records."""
    if len(odometry) < 2:
        return []
    stamps_s = 1e-9 * np.array([stamp_ns for stamp_ns, _ in odometry], dtype=np.float64)
    poses = np.array([pose.array() for _, pose in odometry])
    periods_s, steps = np.diff(stamps_s), np.diff(poses, axis=0)
    lines = []
    usual_s = float(np.median(periods_s))
    gaps = np.flatnonzero(periods_s > max(GAP_S, 3.0 * usual_s))
    if len(gaps):
        longest = gaps[np.argmax(periods_s[gaps])]
        lines.append(
            f"odometry has {len(gaps)} gaps, the longest of {periods_s[longest]:.1f} s after "
            f"{stamps_s[longest] - stamps_s[0]:.1f} s; it comes every {usual_s:.3f} s otherwise"
        )
    passed_s = np.maximum(periods_s, 0.0)
    moved_m, turned = np.hypot(steps[:, 0], steps[:, 1]), np.abs(wrap_angle(steps[:, 2]))
    jumps = np.flatnonzero((moved_m > _FASTEST * passed_s + JOLT_M) | (turned > _FASTEST_RAD * passed_s + JOLT_RAD))
    if len(jumps):
        largest = jumps[np.argmax(moved_m[jumps])]
        lines.append(
            f"odometry jumps {len(jumps)} times, by up to {moved_m[largest]:.1f} m after "
            f"{stamps_s[largest] - stamps_s[0]:.1f} s: it may have begun anew, or be the frame of a map"
        )
    return lines


def found_turns(scans: Sequence[Scan], frame: str) -> str | None:
    """What is wrong with scans of one topic and `frame` if they are those of two lasers in turn; None if they are not.

    Robots that stand, too: the next scan would else resemble the first as the second next one does.
    """
    if not _take_turns(scans):
        return None
    return f"found scans of two lasers in turn, all of frame {shown_name(frame)}, allowed: a frame for each laser"


def _take_turns(scans: Sequence[Scan]) -> bool:
    """Whether scans resemble the second next one and not the next one, along the whole log."""
    if len(scans) < _FEWEST:
        return False
    first = np.unique(np.linspace(0, len(scans) - 3, _MOST_TRIPLES).astype(int))
    found = [_resembles_the_second_next(*(_view(scan) for scan in scans[k : k + 3])) for k in first]
    return float(np.mean(found)) >= _SHARE


def _view(scan: Scan) -> Array:
    """(36,) median range in each sector of bearings, m; NaN where no beam has returned."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    sector = np.floor(scan.bearings * (_BINS / (2.0 * np.pi))).astype(int) % _BINS
    returned = np.isfinite(ranges) & (ranges > 0.0) & (ranges <= scan.max_range)
    own = [ranges[returned & (sector == k)] for k in range(_BINS)]
    return np.array([np.median(values) if len(values) else np.nan for values in own])


def _resembles_the_second_next(first: Array, next_one: Array, second_next: Array) -> bool:
    to_next, to_second = _difference(first, next_one), _difference(first, second_next)
    return to_next > _LEAST_M and to_second < _RATIO * to_next


def _difference(one: Array, other: Array) -> float:
    """Median difference of two views, m; that of views which share no sector is infinite."""
    off = np.abs(one - other)
    return float(np.nanmedian(off)) if np.isfinite(off).any() else float("inf")
