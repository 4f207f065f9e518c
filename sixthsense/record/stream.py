"""The record of a run, written as the run goes: `record.jsonl`, a JSON object per line.

The first line describes the run: format, robot's radius and scene. Then follows a line for each keyframe (`keyframe`),
plan (`plan`) and scan (`scan`), written in batches while the run goes on: those of a kind in order, one kind after the
other in each batch. The last line is the run's end (`end`). Every float64 is kept to the
last bit; walls and observations of a keyframe are rows of them in base64. A killed run has no `end`, and its last line
may be cut.
"""

from __future__ import annotations

import base64
import contextlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sixthsense.config import as_table
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.record.trace import Trace
from sixthsense.record.writing import naming
from sixthsense.sources.scene import Scene

FILE = "record.jsonl"
FORMAT = 1
COUNTS = ("culled", "walls_merged")
"""of the trace, in the last line"""
COUNTS_OF_DRIVES = ("plans_below_margin", "plans_by_astar", "guard_stops")
"""the same, None for a log"""

Line = dict[str, Any]


class RecordWriter:
    """Writes `FOLDER/record.jsonl`: call `flush` while the run goes on, and leave its `with` block at the end.

    A killed run loses what its trace has gained since the last call. Raises OSError, naming the file, when it cannot be
    written.
    """

    def __init__(self, folder: Path) -> None:
        """Begin a record in the run's `folder`."""
        self._file = folder / FILE
        self._stream = self._file.open("w", encoding="utf-8")
        self._has_begun = False
        self._trace: Trace | None = None
        self._keyframes = self._scans = self._plans = 0

    def __enter__(self) -> RecordWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Write the rest and close the file; after an OSError what was written stays as it is."""
        try:
            if self._trace is not None and (kind is None or not issubclass(kind, OSError)):
                self.flush(self._trace)
        finally:
            with contextlib.suppress(OSError):
                self._stream.close()

    def flush(self, trace: Trace) -> None:
        """Write every keyframe, plan and scan of the trace that has not been written yet."""
        self._trace = trace
        lines: list[Line] = [] if self._has_begun else [_run_line(trace)]
        self._has_begun = True
        lines += [_keyframe_line(trace, k) for k in range(self._keyframes, len(trace.key_stamps_ns))]
        lines += [{"plan": path.tolist()} for path in trace.plans[self._plans :]]
        lines += [_scan_line(trace, k) for k in range(self._scans, len(trace.stamps_ns))]
        self._keyframes, self._plans, self._scans = len(trace.key_stamps_ns), len(trace.plans), len(trace.stamps_ns)
        self._write(lines)

    def end(self, trace: Trace) -> None:
        """Write the last line of a run that is over."""
        self.flush(trace)
        self._write([_end_line(trace)])

    def _write(self, lines: list[Line]) -> None:
        with naming(self._file):
            self._stream.write("".join(f"{_to_json(line)}\n" for line in lines))
            self._stream.flush()


def write_end(folder: Path, trace: Trace) -> None:
    """Append the end of the run to the record in `folder`, or write the whole record if none was streamed there."""
    file = folder / FILE
    if not file.exists():
        with RecordWriter(folder) as writer:
            writer.end(trace)
        return
    with file.open("a", encoding="utf-8") as stream:
        stream.write(f"{_to_json(_end_line(trace))}\n")


_to_json = json.JSONEncoder(separators=(",", ":")).encode


def _run_line(trace: Trace) -> Line:
    return {"format": FORMAT, "radius_m": trace.radius_m, "scene": _scene(trace.scene)}


def _scene(scene: Scene | None) -> Line | None:
    """The scene itself: the record outlives its file."""
    if scene is None:
        return None
    start = None if scene.start is None else scene.start.array().tolist()
    return {
        "name": scene.name,
        "walls": scene.walls.tolist(),
        "start": start,
        "radius": scene.radius,
        "goal": scene.goal,
        "tour": scene.tour,
        "region": scene.region,
        "solid_left": scene.solid_left,
        "glass": scene.glass.tolist(),
        "walkers": [as_table(walk) for walk in scene.walkers],
    }


def _scan_line(trace: Trace, k: int) -> Line:
    log_stamp_s = trace.log_stamps_s[k]
    assert trace.last_position is not None
    line = {
        "scan": trace.stamps_ns[k],
        "log_stamp_s": None if math.isnan(log_stamp_s) else log_stamp_s,
        "estimate": trace.estimates[k].tolist(),
        "odometry": trace.odometry[k].tolist(),
        "last_key": trace.last_key[k],
        "since_key": trace.since_key[k].tolist(),
        "path_length_m": trace.path_length_m,
    }
    if trace.truths:
        line["truth"] = trace.truths[k].tolist()
    if trace.walkers:
        line["walkers"], line["touches"] = trace.walkers[k].tolist(), trace.touches
    return line


def _keyframe_line(trace: Trace, k: int) -> Line:
    estimate, association, motion = trace.key_estimates[k], trace.associations[k], trace.key_odometry[k]
    predicted = trace.key_predicted[k]
    line = {
        "keyframe": trace.key_stamps_ns[k],
        "motion": motion.motion.array().tolist(),
        "motion_cov": motion.cov.tolist(),
        "pose": estimate.pose.array().tolist(),
        "pose_cov": estimate.pose_cov.tolist(),
        "observations": packed(_observations(association.observations)),
        "discarded": int(association.discarded),
        "nis": float(association.nis),
        "dof": int(association.dof),
        "fused": int(association.fused),
        "predicted_pose": predicted.pose.array().tolist(),
        "predicted_cov": predicted.pose_cov.tolist(),
        "walls": packed(trace.walls_found[k]),
        "ms": trace.stopwatch.rows[k],
        "total_ms": trace.stopwatch.totals,
    }
    if trace.key_truths:
        line["truth"] = trace.key_truths[k].tolist()
    return line


def packed(numbers: ArrayLike) -> str:
    """Float64 numbers, little-endian, in base64: a long list of them takes a fraction of the time to write."""
    return base64.b64encode(np.asarray(numbers, dtype="<f8").tobytes()).decode("ascii")


def _observations(observations: Mapping[LandmarkId, Observation]) -> list[list[float]]:
    """A row per match: landmark's id, kind, z (2), its covariance (4), extent (2)."""
    return [[i, int(s.kind), *s.z.tolist(), *s.cov.ravel().tolist(), *s.extent] for i, s in observations.items()]


def _end_line(trace: Trace) -> Line:
    last_position = trace.last_position
    return {
        "end": trace.outcome,
        "wall_time_s": trace.wall_time_s,
        "path_length_m": trace.path_length_m,
        "last_position": None if last_position is None else last_position.tolist(),
        "total_ms": trace.stopwatch.totals,
        "left": [[place.x, place.y, place.area_m2, place.reason, place.gap_m] for place in trace.left],
        **{name: getattr(trace, name) for name in (*COUNTS, *COUNTS_OF_DRIVES)},
        "loop_closures": None if trace.loop_closures is None else trace.loop_closures._asdict(),
        **({} if trace.wheels is None else {"wheels": trace.wheels.tolist()}),
        **({} if trace.sensor is None else {"sensor": trace.sensor.tolist()}),
    }
