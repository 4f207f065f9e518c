"""The witnesses of a run for or against its map."""

from __future__ import annotations

import numpy as np

from sixthsense.record.trace import Trace
from sixthsense.verdict.witnesses import Witnesses


def witnesses_of(trace: Trace, last: int | None = None) -> Witnesses:
    """What a trace has of wheels, scans and estimate so far, or what it has of its `last` keyframes."""
    trajectory = trace.trajectory if trace.live is None else trace.live.estimator.trajectory()
    count, last_key = len(trajectory), np.array(trace.last_key, dtype=np.int64)
    first = 0 if last is None else max(0, count - last)
    keys = np.searchsorted(last_key, np.arange(first, count))
    scan = int(keys[0]) if first else 0
    is_scan = keys < len(last_key)
    is_scan[is_scan] = last_key[keys[is_scan]] == np.arange(first, count)[is_scan]
    has_final = trace.live is None and min(trace.last_key, default=-1) >= 0
    poses = trace.scan_poses() if has_final else np.array(trace.estimates[scan:], dtype=np.float64).reshape(-1, 3)
    matched = np.array([len(each.observations) for each in trace.associations[first:]], dtype=np.int64)
    scans = tuple(trace.key_scans[first:])
    return Witnesses(
        np.array(trace.stamps_ns[scan:], dtype=np.int64),
        poses,
        None if trace.config.no_odometry else np.array(trace.odometry[scan:], dtype=np.float64).reshape(-1, 3),
        np.where(is_scan, keys - scan, -1),
        np.asarray(trajectory[first:], dtype=np.float64).reshape(-1, 3),
        np.array(trace.key_measured[first:], dtype=np.bool_),
        scans if any(each is not None for each in scans) else (),
        None if trace.links is None or first else trace.links.ends,
        matched if matched.any() else None,
        trace.loop_closures,
    )
