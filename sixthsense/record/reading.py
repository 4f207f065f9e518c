"""Reading `record.jsonl` back into a trace, line by line."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.core.sensor import SENSOR_PARAMETERS
from sixthsense.core.wheels import PARAMETERS
from sixthsense.navigation.unseen_places import UnseenPlace, as_reason
from sixthsense.record.stream import COUNTS, COUNTS_OF_DRIVES, FORMAT, Line
from sixthsense.record.trace import STAGES, Trace
from sixthsense.slam.association.records import Association
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.front_end import LoopClosureCounts
from sixthsense.sources.scene import Scene
from sixthsense.sources.walking_space import ScriptedWalk

_LARGEST = (1 << 63) - 1


def read_stream(file: Path, config: Config) -> tuple[Trace, bool]:
    """The trace that a `record.jsonl` holds, and whether the run's end is in it.

    The estimates at keyframes are read without their landmarks, which the file does not hold. Raises InputError for a
    file that cannot be read, a line that is damaged, and a record without a scan.
    """
    trace: Trace | None = None
    has_ended = False
    try:
        for number, line in enumerate(_whole_lines(file), start=1):
            try:
                if has_ended:
                    raise ValueError("a line after the end")
                table = _table(line)
                if trace is None:
                    trace = _begun(table, config)
                else:
                    has_ended = _take(table, trace)
            except (LookupError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
                found = str(error) if isinstance(error, ValueError) else shown(line)
                allowed = "a line of a run's record"
                raise InputError(file, f"line {number}: found {' '.join(found.split())}", allowed) from None
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})") from None
    if trace is None or not trace.stamps_ns:
        raise InputError(file, "found no scan", "the record of a run")
    return trace, has_ended


def _whole_lines(file: Path) -> Iterator[bytes]:
    """The lines of a file but for the one that a killed writer has cut."""
    with file.open("rb") as stream:
        for line in stream:
            if line.endswith(b"\n"):
                yield line


def _table(line: bytes) -> Line:
    try:
        table = json.loads(line)
    except ValueError:
        raise ValueError("no JSON") from None
    if not isinstance(table, dict):
        raise ValueError("no table")
    return table


def _begun(table: Line, config: Config) -> Trace:
    """The trace of a run that has begun, from the first line."""
    if table.get("format") != FORMAT:
        raise ValueError(f"format {shown(table.get('format'))}, not {FORMAT}")
    return Trace(config, _scene(table["scene"]), _number(table, "radius_m"))


def _scene(table: Line | None) -> Scene | None:
    if table is None:
        return None
    start, goal = table["start"], table["goal"]
    x0, y0, x1, y1 = _array(table, "region", (4,)).tolist()
    tour = _array(table, "tour", (-1, 2)).tolist()
    return Scene(
        str(table["name"]),
        _array(table, "walls", (-1, 2, 2)),
        None if start is None else _pose(table, "start"),
        _number(table, "radius"),
        None if goal is None else _point(_array(table, "goal", (2,))),
        tuple((x, y) for x, y in tour),
        (x0, y0, x1, y1),
        table["solid_left"] is True,
        _array(table, "glass", (-1, 2, 2)),
        tuple(ScriptedWalk(**walk) for walk in table["walkers"]),
    )


def _point(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _take(table: Line, trace: Trace) -> bool:
    """Add what a line tells to the trace; whether it was the run's end."""
    for kind, take in _KINDS.items():
        if kind in table:
            take(table, trace)
            return kind == "end"
    raise ValueError(f"a line without any of {', '.join(_KINDS)}")


def _take_scan(table: Line, trace: Trace) -> None:
    _take_truth(table, trace.stamps_ns, trace.truths)
    last_key = _whole(table, "last_key", -1)
    if last_key >= len(trace.key_stamps_ns):
        raise ValueError(f"last_key {last_key} after {len(trace.key_stamps_ns)} keyframes")
    trace.last_key.append(last_key)
    trace.stamps_ns.append(_stamp(table, "scan", trace.stamps_ns))
    trace.log_stamps_s.append(np.nan if table["log_stamp_s"] is None else _number(table, "log_stamp_s"))
    trace.estimates.append(_array(table, "estimate", (3,)))
    trace.odometry.append(_array(table, "odometry", (3,)))
    trace.since_key.append(_array(table, "since_key", (3,)))
    if "walkers" in table:
        trace.walkers.append(_array(table, "walkers", (-1, 3)))
        by_robot, by_walkers = (int(count) for count in _array(table, "touches", (2,)))
        trace.touches = by_robot, by_walkers
    trace.path_length_m = _number(table, "path_length_m")
    trace.last_position = (trace.truths or trace.odometry)[-1][:2]


def _take_keyframe(table: Line, trace: Trace) -> None:
    _take_truth(table, trace.key_stamps_ns, trace.key_truths)
    trace.key_stamps_ns.append(_stamp(table, "keyframe", trace.key_stamps_ns))
    trace.key_odometry.append(Odometry(_pose(table, "motion"), _array(table, "motion_cov", (3, 3))))
    trace.key_predicted.append(_estimate(table, "predicted_pose", "predicted_cov"))
    trace.key_estimates.append(_estimate(table, "pose", "pose_cov"))
    observations = dict(map(_observation, _unpacked(table, "observations", (-1, 10)).tolist()))
    discarded, dof, fused = (_whole(table, name) for name in ("discarded", "dof", "fused"))
    trace.associations.append(Association(observations, discarded, _number(table, "nis"), dof, fused))
    trace.walls_found.append(_unpacked(table, "walls", (-1, 2, 2)))
    trace.stopwatch.rows.append(_times(table, "ms"))
    trace.stopwatch.totals |= _times(table, "total_ms")


def _take_plan(table: Line, trace: Trace) -> None:
    trace.plans.append(_array(table, "plan", (-1, 2)))


def _take_end(table: Line, trace: Trace) -> None:
    if not isinstance(table["end"], str):
        raise ValueError(f"end {shown(table['end'])}, not a word")
    trace.outcome = table["end"]
    trace.wall_time_s, trace.path_length_m = _number(table, "wall_time_s"), _number(table, "path_length_m")
    if table["last_position"] is not None:
        trace.last_position = _array(table, "last_position", (2,))
    trace.stopwatch.totals |= _times(table, "total_ms")
    trace.left = [
        UnseenPlace(float(x), float(y), float(m2), as_reason(why), None if gap_m is None else float(gap_m))
        for x, y, m2, why, gap_m in table["left"]
    ]
    for name in COUNTS:
        setattr(trace, name, _whole(table, name))
    for name in COUNTS_OF_DRIVES:
        setattr(trace, name, None if table[name] is None else _whole(table, name))
    if (counts := table["loop_closures"]) is not None:
        trace.loop_closures = LoopClosureCounts(*(_whole(counts, name) for name in LoopClosureCounts._fields))
    if "wheels" in table:
        trace.wheels = _array(table, "wheels", (2, PARAMETERS))
    if "sensor" in table:
        trace.sensor = _array(table, "sensor", (2, SENSOR_PARAMETERS))


_KINDS: dict[str, Callable[[Line, Trace], None]] = {
    "scan": _take_scan,
    "keyframe": _take_keyframe,
    "plan": _take_plan,
    "end": _take_end,
}


def _observation(row: list[float]) -> tuple[LandmarkId, Observation]:
    landmark, kind, x, y, c00, c01, c10, c11, first, last = row
    if not landmark.is_integer():
        raise ValueError(f"an observation of landmark {landmark}")
    cov = np.array([[c00, c01], [c10, c11]])
    return int(landmark), Observation(Kind(int(kind)), np.array([x, y]), cov, (first, last))


def _take_truth(table: Line, stamps_ns: Sequence[int], truths: list[Array]) -> None:
    """Add the true pose, which all lines of a kind have, or none."""
    if stamps_ns and bool(truths) != ("truth" in table):
        raise ValueError("the truth in some lines and not in others")
    if "truth" in table:
        truths.append(_array(table, "truth", (3,)))


def _stamp(table: Line, name: str, before: list[int]) -> int:
    stamp_ns = _whole(table, name)
    if before and stamp_ns <= before[-1]:
        raise ValueError(f"{name} at {stamp_ns} ns after {before[-1]} ns")
    return stamp_ns


def _whole(table: Line, name: str, least: int = 0) -> int:
    value = table[name]
    if type(value) is not int or not least <= value <= _LARGEST:
        raise ValueError(f"{name} {shown(value)}")
    return value


def _number(table: Line, name: str) -> float:
    return float(_array(table, name, ()))


def _pose(table: Line, name: str) -> Pose:
    return Pose.from_array(_array(table, name, (3,)))


def _estimate(table: Line, pose: str, cov: str) -> Estimate:
    return Estimate.of_pose(_pose(table, pose), _array(table, cov, (3, 3)))


def _times(table: Line, name: str) -> dict[str, float]:
    times = table[name]
    if not isinstance(times, dict) or not set(times) <= set(STAGES):
        raise ValueError(f"{name} {shown(times)}")
    return {stage: _number(times, stage) for stage in times}


def _unpacked(table: Line, name: str, shape: tuple[int, ...]) -> Array:
    """The numbers of that name, packed in base64, in a shape whose first length is any."""
    try:
        array = np.frombuffer(base64.b64decode(table[name], validate=True), dtype="<f8").reshape(shape)
    except (TypeError, ValueError):
        raise ValueError(f"{name} {shown(table[name])}") from None
    return checked(name, array, shape)


def _array(table: Line, name: str, shape: tuple[int, ...]) -> Array:
    """The numbers of that name in that shape, in which a first length of -1 is any."""
    try:
        array = np.array(table[name], dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} {shown(table[name])}") from None
    return checked(name, array.reshape(0, *shape[1:]) if array.size == 0 and shape[:1] == (-1,) else array, shape)


def checked(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> Array:
    """Finite numbers in that shape, in which a first length of -1 is any; ValueError for any others."""
    expected = (*array.shape[:1], *shape[1:]) if shape[:1] == (-1,) else shape
    if array.dtype.kind != "f" or array.shape != expected or not np.isfinite(array).all():
        raise ValueError(f"{name} of shape {array.shape} and type {array.dtype}, or with a number that is not finite")
    return np.array(array, dtype=np.float64)
