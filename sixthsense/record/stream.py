"""`RecordWriter`: the record of a run, written while it goes on."""

from __future__ import annotations

import contextlib
import json
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.version import __version__
from sixthsense.core.source import Tick
from sixthsense.logs.runfolder import CLOSURE, FORMAT, TICK, observation_rows
from sixthsense.record.fields import BEGIN, end_table, keyframe_table, packed, scan_row
from sixthsense.record.trace import Trace
from sixthsense.record.writing import naming

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
        if tick.increment_cov is not None:
            row["increment_cov"] = tick.increment_cov
        if tick.truth is not None:
            row["truth"] = tick.truth.array()
        if tick.log_stamp_s is not None:
            row["log_stamp_s"] = tick.log_stamp_s
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
