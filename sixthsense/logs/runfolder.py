"""The record of a run: an MCAP file of rows and values of JSON by channel; and what the run received, as a log.

Messages of a channel with encoding `json` are values of JSON. Those of encoding `rows` are rows of an array, one after
the other, little-endian. The schema of the channel has the columns: name, NumPy's type and shape of each. An array
without columns has one, whose name is empty.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError, reason_of
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Closure, Tick, seconds
from sixthsense.logs.finding import Finding
from sixthsense.logs.log import Log

FILE = "record.mcap"
FORMAT = 4
TICK = np.dtype([
    ("odometry", "<f8", (3,)), ("is_unmeasured", "?"), ("increment_cov", "<f8", (3, 3)), ("truth", "<f8", (3,)),
    ("log_stamp_s", "<f8"),
])  # fmt: skip
"""a tick; NaN for what it does not have"""
OBSERVATION = np.dtype([
    ("landmark", "<i8"), ("kind", "<i8"), ("z", "<f8", (2,)), ("cov", "<f8", (2, 2)), ("extent", "<f8", (2,))
])  # fmt: skip
CLOSURE = np.dtype([("before", "<i8"), ("motion", "<f8", (3,)), ("cov", "<f8", (3, 3))])

_LARGEST_CHUNK = 1 << 26  # bytes; chunks of a run have one million


class Message(NamedTuple):
    """One message of a record."""

    channel: str
    stamp_ns: int
    value: Any
    """(n,) rows of the channel, or a value of JSON"""


def read_run(folder: str | Path, laser: LaserConfig) -> Log:
    """Read what a run received from the record in its folder, or in its `.partial`.

    `laser` is that of the folder's configuration; beams and ranges come from the record. An incomplete record is read
    up to its last whole chunk. Raises InputError for a folder without a record, and a record without a scan or an
    observation.
    """
    file = Path(folder) / FILE
    messages, is_cut = read_messages(file)
    with readable(file):
        ticks = ticks_of(messages, Pose(*laser.mount))
    if not any(tick.scan is not None or tick.observations is not None for tick in ticks):
        raise InputError(file, f"found no scan and no observation{' before it ends' * is_cut}", "the record of a run")
    used_s = seconds(ticks[-1].stamp_ns - ticks[0].stamp_ns)
    text = f"the recording is incomplete; its first {used_s:.1f} s are used"
    return Log(ticks, laser, [Finding("cut_short", used_s, place=text)] * is_cut)


def paths_of(messages: Sequence[Message], channel: str) -> list[tuple[int, NDArray[Any]]]:
    """Stamps, ns, and paths (N, 2) of the channel `plan` or `tour`."""
    return [(message.stamp_ns, message.value) for message in messages if message.channel == channel]


def observation_rows(observations: Mapping[LandmarkId, Observation]) -> NDArray[Any]:
    """(n,) rows of `OBSERVATION`."""
    rows = [(i, int(seen.kind), seen.z, seen.cov, seen.extent) for i, seen in observations.items()]
    return np.array(rows, dtype=OBSERVATION)


def ticks_of(messages: Sequence[Message], mount: Pose) -> list[Tick]:
    """The ticks; a scan without a stamp of its log has that of its first beam.

    Raises ValueError for stamps that do not ascend, and for a loop closure with no earlier tick.
    """
    ticks: list[Tick] = []
    laser: Mapping[str, Any] = {}
    for channel, stamp_ns, value in messages:
        if channel == "tick":
            if ticks and stamp_ns <= ticks[-1].stamp_ns:
                raise ValueError(f"a tick at {stamp_ns} ns after {ticks[-1].stamp_ns} ns")
            ticks.append(_tick(stamp_ns, value[0]))
        elif channel == "laser":
            laser = value
        elif channel == "scan" and ticks:
            names = "angle_min", "angle_increment", "time_increment"
            first, step, lag = (np.float32(laser[name]) for name in names)
            seen, own_s = Scan(value, first, step, float(laser["max_range"]), mount, lag), ticks[-1].log_stamp_s
            began_s = max(stamp_ns + sweep_ns(len(value), lag), 0) / 1_000_000_000
            ticks[-1] = replace(ticks[-1], scan=seen, log_stamp_s=began_s if own_s is None else own_s)
        elif channel == "observations" and ticks:
            seen_by_id = {
                int(i): Observation(Kind(kind), z, cov, tuple(extent.tolist())) for i, kind, z, cov, extent in value
            }
            ticks[-1] = replace(ticks[-1], observations=seen_by_id)
        elif channel == "closures" and ticks:
            closures = tuple(Closure(int(before), Pose.from_array(motion), cov) for before, motion, cov in value)
            if any(not 0 <= closure.before < len(ticks) - 1 for closure in closures):
                raise ValueError(f"a loop closure of tick {len(ticks) - 1} with no earlier one")
            ticks[-1] = replace(ticks[-1], closures=closures)
    return ticks


def _tick(stamp_ns: int, row: Any) -> Tick:
    kinds: dict[str, Any] = {"increment_cov": np.asarray, "truth": Pose.from_array, "log_stamp_s": float}
    known = {name: kind(row[name]) for name, kind in kinds.items() if not np.isnan(row[name]).any()}
    return Tick(stamp_ns, Pose.from_array(row["odometry"]), is_unmeasured=bool(row["is_unmeasured"]), **known)


def read_messages(file: Path) -> tuple[list[Message], bool]:
    """All messages of a record, and whether it ends early: then those of its whole chunks.

    Raises InputError for a file that cannot be read, that is no record, or whose record has another format.
    """
    from mcap.exceptions import InvalidMagic
    from mcap.reader import NonSeekingReader

    is_cut, raw = False, []
    with readable(file):
        with file.open("rb") as stream:
            reader = NonSeekingReader(stream, validate_crcs=True, record_size_limit=_LARGEST_CHUNK)
            try:
                for each in reader.iter_messages(log_time_order=False):
                    raw.append(each)
            except InvalidMagic:
                raise InputError(file, "is not an MCAP file", "the record of a run") from None
            except Exception:  # the writer was stopped here; an incomplete record raises any exception
                is_cut = True
        rows = {schema.id: _row_type(schema.data) for schema, *_ in raw if schema and schema.encoding == "rows"}
        found = [
            Message(channel.topic, message.log_time, _value(message.data, rows.get(channel.schema_id)))
            for _, channel, message in raw
        ]
        if not found or found[0].channel != "run" or found[0].value["format"] != FORMAT:
            raise InputError(file, "found no record of this version", "the record of a run")
    return found, is_cut


@contextlib.contextmanager
def readable(file: Path) -> Iterator[None]:
    """Within the block whatever is wrong with the content of a file is an InputError that names it."""
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(file, "no such file", "the folder of a run of this version") from None
    except Exception as error:  # a message with a valid checksum may still be invalid
        raise InputError(file, f"found {reason_of(error)}", "the record of a run") from None


def _value(data: bytes, row: np.dtype[Any] | None) -> Any:
    """A value of JSON, or (n,) rows; none of an array without columns, such as the covariance of no landmarks."""
    if row is None:
        return json.loads(data)
    return np.frombuffer(data, row) if row.itemsize else np.zeros(0, row)


def _row_type(schema: bytes) -> np.dtype[Any]:
    """NumPy's type of a row."""
    types = [(str(name), np.dtype(kind), tuple(shape)) for name, kind, shape in json.loads(schema)]
    if any(kind.kind not in "fiub" for _, kind, _ in types):
        raise ValueError("a column that has no numbers")
    return np.dtype(types[0][1:] if types[0][0] == "" else types)
