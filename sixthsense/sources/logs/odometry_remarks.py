"""What a user should know of recorded odometry: its gaps and its jumps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sixthsense.core.geometry import Pose, wrap_angle

_GAP_S = 0.5  # a live robot's odometry is not interpolated over a longer one either
_FASTEST, _FASTEST_RAD = 5.0, 5.0  # m/s and rad/s of a robot on wheels in a building
_JOLT_M, _JOLT_RAD = 0.5, 0.5  # at any moment, as for a live robot


def remarks_on(odometry: Sequence[tuple[int, Pose]]) -> list[str]:
    """A line each on gaps and jumps of poses with stamps, ns, in the order of the records."""
    if len(odometry) < 2:
        return []
    stamps_s = 1e-9 * np.array([stamp_ns for stamp_ns, _ in odometry], dtype=np.float64)
    poses = np.array([pose.array() for _, pose in odometry])
    periods_s, steps = np.diff(stamps_s), np.diff(poses, axis=0)
    lines = []
    usual_s = float(np.median(periods_s))
    gaps = np.flatnonzero(periods_s > max(_GAP_S, 3.0 * usual_s))
    if len(gaps):
        longest = gaps[np.argmax(periods_s[gaps])]
        lines.append(
            f"odometry has {len(gaps)} gaps, the longest of {periods_s[longest]:.1f} s after "
            f"{stamps_s[longest] - stamps_s[0]:.1f} s; it comes every {usual_s:.3f} s otherwise"
        )
    passed_s = np.maximum(periods_s, 0.0)
    moved_m, turned = np.hypot(steps[:, 0], steps[:, 1]), np.abs(wrap_angle(steps[:, 2]))
    jumps = np.flatnonzero((moved_m > _FASTEST * passed_s + _JOLT_M) | (turned > _FASTEST_RAD * passed_s + _JOLT_RAD))
    if len(jumps):
        largest = jumps[np.argmax(moved_m[jumps])]
        lines.append(
            f"odometry jumps {len(jumps)} times, by up to {moved_m[largest]:.1f} m after "
            f"{stamps_s[largest] - stamps_s[0]:.1f} s: it may have begun anew, or be the frame of a map"
        )
    return lines
