"""The record of a run: the fields of a trace that it has, as rows and values of JSON, and `RecordWriter`.

Fields are read back by the types of the trace's fields.
"""

from __future__ import annotations

import contextlib
import functools
import json
import time
import typing
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, create_model
from pydantic_core import to_jsonable_python

from sixthsense.config.version import __version__
from sixthsense.core.source import Tick
from sixthsense.logs.runfolder import CLOSURE, FORMAT, TICK, observation_rows
from sixthsense.record.trace import Trace
from sixthsense.record.writing import naming
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid

BEGIN = ("scene", "radius_m")
"""what is known before the first tick; the scene outlives its file"""
SCAN = ("log_stamps_s", "estimates", "odometry", "truths", "walkers", "last_key", "since_key", "since_covs")
"""lists with a value per scan, which are rows; one that is empty has no column"""
KEYFRAME = (
    *("key_truths", "key_measured", "key_odometry", "key_predicted", "key_estimates"),
    *("associations", "walls_found"),
)
"""lists with a value per keyframe, of JSON; one that is empty is left out"""
END = (
    *("outcome", "path_length_m", "wall_time_s", "last_position", "culled", "walls_merged", "plans_below_margin"),
    *("plans_by_astar", "guard_stops", "loop_closures", "wheels", "sensor", "left", "verdict", "trajectory", "final"),
    *("joint_cov", "records", "links", "relations"),
)
"""what is known when a run has ended"""

_LARGEST = 64  # numbers of an array within JSON

Arrays = Mapping[str, NDArray[Any]]


def packed(value: Any, arrays: dict[str, NDArray[Any]] | None = None) -> Any:
    """A value as one of JSON: an array is `{"array": [type, shape, numbers]}`.

    A large one is added to `arrays`, if there are some, and `{"channel": name}` takes its place.
    """

    def of_numpy(found: Any) -> Any:
        if isinstance(found, np.generic):
            return found.item()
        if arrays is None or found.size <= _LARGEST:
            return {"array": [found.dtype.str, found.shape, found.ravel().tolist()]}
        arrays[f"array.{len(arrays)}"] = found
        return {"channel": f"array.{len(arrays) - 1}"}

    return to_jsonable_python(value, fallback=of_numpy)


def _unpacked(value: Any, arrays: Arrays) -> Any:
    """The arrays in a value of JSON in their places."""
    if isinstance(value, list):
        return [_unpacked(one, arrays) for one in value]
    if not isinstance(value, dict):
        return value
    if "channel" in value:
        return arrays[value["channel"]]
    if "array" in value:
        kind, shape, numbers = value["array"]
        return np.array(numbers, kind).reshape(shape)
    return {name: _unpacked(one, arrays) for name, one in value.items()}


@functools.cache
def _model(names: tuple[str, ...]) -> type[BaseModel]:
    """A model with these fields of a trace."""
    hints = typing.get_type_hints(Trace)
    fields: dict[str, Any] = {name: (hints[name], ...) for name in names}
    return create_model("Fields", __config__=ConfigDict(arbitrary_types_allowed=True), **fields)


def read_fields(table: Mapping[str, Any], arrays: Arrays = MappingProxyType({})) -> dict[str, Any]:
    """The values of fields of a trace, by name, that `packed` has made; ValueError for others."""
    return dict(_model(tuple(table))(**{name: _unpacked(value, arrays) for name, value in table.items()}))


def scan_row(trace: Trace, k: int) -> NDArray[Any]:
    """(1,) row of a scan, with the length of the path and the touches so far."""
    columns = {name: values[k] for name in SCAN if (values := getattr(trace, name))}
    columns |= {"path_length_m": trace.path_length_m} | ({} if trace.touches is None else {"touches": trace.touches})
    arrays = {name: np.asarray(value) for name, value in columns.items()}
    return np.array([tuple(arrays.values())], [(name, array.dtype, array.shape) for name, array in arrays.items()])


def read_scans(trace: Trace, rows: NDArray[Any]) -> None:
    """Set in a trace what the rows of all scans have."""
    names = rows.dtype.names or ()
    for name in set(SCAN) & set(names):
        setattr(trace, name, rows[name].tolist() if rows[name].ndim == 1 else list(rows[name]))
    if "touches" in names:
        trace.touches = tuple(rows["touches"][-1].tolist())
    trace.path_length_m = float(rows["path_length_m"][-1])


def keyframe_table(trace: Trace, k: int) -> Any:
    """The values of a keyframe, whose estimate is that of the pose alone, and the times of its stages."""
    values = {name: found[k] for name in KEYFRAME if (found := getattr(trace, name))}
    estimate, watch = trace.key_estimates[k], trace.stopwatch
    values["key_estimates"] = Estimate.of_pose(estimate.pose, estimate.pose_cov)
    return packed({"fields": values, "ms": watch.rows[k], "total_ms": watch.totals})


def read_keyframes(trace: Trace, tables: Sequence[Mapping[str, Any]]) -> None:
    """Set in a trace what the tables of all keyframes have."""
    columns = {name: [table["fields"][name] for table in tables] for name in tables[0]["fields"]}
    for name, values in read_fields(columns).items():
        setattr(trace, name, values)
    trace.stopwatch.rows, trace.stopwatch.totals = [table["ms"] for table in tables], tables[-1]["total_ms"]


def end_table(trace: Trace, metrics: Mapping[str, Any], arrays: dict[str, NDArray[Any]]) -> Any:
    """The values of a run that has ended; large arrays are added to `arrays`."""
    values = {name: getattr(trace, name) for name in END}
    since_key, grid = np.array(trace.since_key).reshape(-1, 3), trace.grid
    cells = grid and [counts.astype(np.min_scalar_type(counts.max(initial=0))) for counts in (grid.hits, grid.passes)]
    more = {"since_key": since_key, "grid": grid and {"origin": grid.origin, "counts": [*(cells or ()), grid.seen]}}
    return packed({"fields": values, **more, "total_ms": trace.stopwatch.totals, "metrics": dict(metrics)}, arrays)


def read_end(trace: Trace, table: Mapping[str, Any], arrays: Arrays) -> None:
    """Set in a trace what `end_table` has of it."""
    for name, value in read_fields(table["fields"], arrays).items():
        setattr(trace, name, value)
    trace.stopwatch.totals, trace.since_key = table["total_ms"], list(_unpacked(table["since_key"], arrays))
    ids = trace.final.ids.tolist()
    if len(trace.joint_cov) != 3 + 2 * len(ids) or not set(ids) <= set(trace.records):
        raise ValueError("landmarks without a record, or a covariance of other landmarks")
    if (grid := _unpacked(table["grid"], arrays)) is not None:
        hits, passes, seen = grid["counts"]
        counts = hits.astype(np.int32), passes.astype(np.int32), seen
        trace.grid = Grid.from_counts(trace.config.grid, trace.radius_m, tuple(grid["origin"]), *counts)


_FLUSH_S = 0.5  # of wall time; the longest part that a killed run loses
_CHUNK_BYTES = 1 << 20


class RecordWriter:
    """Writes an MCAP file as `logs.runfolder` reads it: a hook for the loop's `on_tick`.

    A tick and what the trace has gained with it are written together, and flushed twice per second of wall time, so
    that a killed run loses at most the last one. The file begins with the first tick. Raises OSError that names it if
    it cannot be written; what was flushed before can be read.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._writer: Any = None
        self._channels: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self._laser: dict[str, float] = {}
        self._pending = 0  # bytes
        self._flushed_s = 0.0

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Record a tick, and what the trace has gained with it."""
        with self._writing(trace):
            self._add_tick(tick)
            self._add_new(trace, tick.stamp_ns)
            if self._pending >= _CHUNK_BYTES or time.monotonic() - self._flushed_s >= _FLUSH_S:
                self._flush()

    def end(self, trace: Trace, metrics: Mapping[str, Any]) -> None:
        """Record the rest of the trace, and the end of the run."""
        with self._writing(trace):
            stamp_ns = max([0, *trace.stamps_ns[-1:], *trace.key_stamps_ns[-1:]])
            self._add_new(trace, stamp_ns)
            arrays: dict[str, NDArray[Any]] = {}
            table = end_table(trace, metrics, arrays)
            for channel, array in arrays.items():
                step = max(1, _CHUNK_BYTES // array[:1].nbytes)
                for first in range(0, len(array), step):
                    self._add(channel, stamp_ns, array[first : first + step])
                    self._flush()
            self._add("end", stamp_ns, table)
        self.close()

    def close(self) -> None:
        """Write what is not flushed, and the index; after an error nothing."""
        if self._writer is not None:
            with naming(self.file), self._stream:
                self._writer.finish()
            self._writer = None

    @contextlib.contextmanager
    def _writing(self, trace: Trace) -> Iterator[None]:
        """A block that writes: it begins the file, and closes it after an error."""
        from mcap.writer import IndexType, Writer

        with naming(self.file):
            if self._writer is None:
                self._stream = self.file.open("wb")
                # No chunk ends within a tick: only `_flush` ends one.
                self._writer = Writer(self._stream, chunk_size=1 << 62, index_types=IndexType.CHUNK)
                self._writer.start("", f"sixthsense {__version__}")
                begin = packed({name: getattr(trace, name) for name in BEGIN})
                self._add("run", 0, {"format": FORMAT, "fields": begin})
            try:
                yield
            except OSError:
                self._writer = None
                with contextlib.suppress(OSError):
                    self._stream.close()
                raise

    def _add_tick(self, tick: Tick) -> None:
        stamp_ns, row = tick.stamp_ns, np.full(1, np.nan, dtype=TICK)
        row["odometry"], row["is_unmeasured"] = tick.odometry.array(), tick.is_unmeasured
        truth = None if tick.truth is None else tick.truth.array()
        for name, value in (("increment_cov", tick.increment_cov), ("truth", truth), ("log_stamp_s", tick.log_stamp_s)):
            if value is not None:
                row[name] = value
        self._add("tick", stamp_ns, row)
        if (scan := tick.scan) is not None:
            names = "angle_min", "angle_increment", "time_increment", "max_range"
            laser = {name: float(getattr(scan, name)) for name in names}
            if laser != self._laser:
                self._add("laser", stamp_ns, laser)
                self._laser = laser
            self._add("scan", stamp_ns, scan.ranges)
        if tick.observations is not None:
            self._add("observations", stamp_ns, observation_rows(tick.observations))
        if tick.closures is not None:
            rows = [(one.before, one.motion.array(), one.cov) for one in tick.closures]
            self._add("closures", stamp_ns, np.array(rows, dtype=CLOSURE))

    def _add_new(self, trace: Trace, stamp_ns: int) -> None:
        """Record what the trace has gained: paths at this stamp, keyframes and scans at their own."""
        for k in range(self._counts["keyframe"], len(trace.key_stamps_ns)):
            self._add("keyframe", trace.key_stamps_ns[k], keyframe_table(trace, k))
        for k in range(self._counts["estimate"], len(trace.stamps_ns)):
            self._add("estimate", trace.stamps_ns[k], scan_row(trace, k))
        for channel, paths in (("plan", trace.plans), ("tour", trace.tours)):
            for path in paths[self._counts[channel] :]:
                self._add(channel, stamp_ns, path)

    def _add(self, channel: str, stamp_ns: int, value: NDArray[Any] | dict[str, Any]) -> None:
        if isinstance(value, np.ndarray):
            data, encoding, form, schema = value.tobytes(), "rows", "rows", _columns(value)
        else:
            data, encoding, form, schema = _json(value), "json", "jsonschema", {"type": "object"}
        if channel not in self._channels:
            number = self._writer.register_schema(channel, form, _json(schema))
            self._channels[channel] = self._writer.register_channel(channel, encoding, number)
        self._writer.add_message(self._channels[channel], stamp_ns, data, stamp_ns, self._counts[channel])
        self._counts[channel] += 1
        self._pending += len(data)

    def _flush(self) -> None:
        self._writer.flush()
        self._pending, self._flushed_s = 0, time.monotonic()


def _json(value: Any) -> bytes:
    return json.dumps(value).encode()


def _columns(rows: NDArray[Any]) -> Any:
    """Name, type and shape of each column, as a schema has them."""
    if rows.dtype.fields is None:
        return [("", rows.dtype.str, rows.shape[1:])]
    return [(name, kind.base.str, kind.shape) for name, (kind, *_) in rows.dtype.fields.items()]
