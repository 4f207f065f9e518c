"""The witnesses of a run for or against its map."""

from __future__ import annotations

import numpy as np

from sixthsense.record.trace import Trace
from sixthsense.verdict.witnesses import Witnesses


def witnesses_of(trace: Trace) -> Witnesses:
    """What a trace has of wheels, scans and estimate; of a run that goes on what it has so far."""
    is_over, last_key = trace.live is None, np.array(trace.last_key, dtype=np.int64)
    trajectory = trace.trajectory if is_over else np.array([each.pose.array() for each in trace.key_estimates])
    trajectory = np.asarray(trajectory, dtype=np.float64).reshape(-1, 3)
    count = len(trajectory)
    keys = np.searchsorted(last_key, np.arange(count))
    is_scan = keys < len(last_key)
    is_scan[is_scan] = last_key[keys[is_scan]] == np.flatnonzero(is_scan)
    has_final = is_over and min(trace.last_key, default=-1) >= 0
    matched = np.array([len(each.observations) for each in trace.associations], dtype=np.int64)
    return Witnesses(
        np.array(trace.stamps_ns, dtype=np.int64),
        trace.scan_poses() if has_final else np.array(trace.estimates, dtype=np.float64).reshape(-1, 3),
        None if trace.config.no_odometry else np.array(trace.odometry, dtype=np.float64).reshape(-1, 3),
        np.where(is_scan, keys, -1),
        trajectory,
        np.array(trace.key_measured, dtype=np.bool_),
        tuple(trace.key_scans) if any(scan is not None for scan in trace.key_scans) else (),
        None if trace.links is None else trace.links.ends,
        matched if matched.any() else None,
        trace.loop_closures,
    )
