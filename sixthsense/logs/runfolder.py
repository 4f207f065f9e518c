"""The record of a run: an MCAP file of rows and values of JSON by channel; and what the run received, as a log.

Messages of a channel with encoding `json` are values of JSON. Those of encoding `rows` are rows of an array, one after
the other, little-endian. The schema of the channel has the columns: name, NumPy's type and shape of each. An array
without columns has one, whose name is empty.
"""

from __future__ import annotations

import contextlib
import json
import math
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
from sixthsense.core.source import Closure, Tick
from sixthsense.logs.finding import Finding
from sixthsense.logs.log import Log
from sixthsense.logs.text_lines import check_regular

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


class RunLog(Log):
    """What a run received."""

    messages: Sequence[Message] = ()
    """all that the record holds"""

    def paths(self, channel: str) -> list[tuple[int, NDArray[Any]]]:
        """Stamps, ns, and paths (N, 2) of the channel `plan` or `tour`."""
        return [(message.stamp_ns, message.value) for message in self.messages if message.channel == channel]


def read_run(folder: str | Path, laser: LaserConfig) -> RunLog:
    """Read what a run received from the record in its folder, or in its `.partial`.

    `laser` is that of the folder's configuration; beams and ranges come from the record. An incomplete record is read
    up to its last whole chunk. Raises InputError for a folder without a record, and a record without a scan or an
    observation.
    """
    file = Path(folder) / FILE
    messages, is_cut = read_messages(file)
    with readable(file):
        ticks = list(ticks_of(messages, Pose(*laser.mount)))
    if not any(tick.scan is not None or tick.observations is not None for tick in ticks):
        raise InputError(file, f"found no scan and no observation{' before it ends' * is_cut}", "the record of a run")
    used_s = 1e-9 * (ticks[-1].stamp_ns - ticks[0].stamp_ns)
    text = f"the recording is incomplete; its first {used_s:.1f} s are used"
    log = RunLog(ticks, laser, [Finding("cut_short", used_s, place=text)] * is_cut)
    log.messages = messages
    return log


def observation_rows(observations: Mapping[LandmarkId, Observation]) -> NDArray[Any]:
    """(n,) rows of `OBSERVATION`."""
    rows = [(i, int(seen.kind), seen.z, seen.cov, seen.extent) for i, seen in observations.items()]
    return np.array(rows, dtype=OBSERVATION)


def observations_of(rows: NDArray[Any]) -> dict[LandmarkId, Observation]:
    """The inverse of `observation_rows`."""
    return {
        int(row["landmark"]): Observation(Kind(row["kind"]), row["z"], row["cov"], tuple(row["extent"].tolist()))
        for row in rows
    }


def ticks_of(messages: Sequence[Message], mount: Pose) -> Iterator[Tick]:
    """The ticks; a scan without a stamp of its log has that of its first beam.

    Raises ValueError for stamps that do not ascend, and for a loop closure with no earlier tick.
    """
    tick: Tick | None = None
    laser: Mapping[str, Any] = {}
    number = -1
    for channel, stamp_ns, value in messages:
        if channel == "tick":
            if tick is not None:
                yield tick
                if stamp_ns <= tick.stamp_ns:
                    raise ValueError(f"a tick at {stamp_ns} ns after {tick.stamp_ns} ns")
            tick, number = _tick(stamp_ns, value[0]), number + 1
        elif channel == "laser":
            laser = value
        elif tick is None:
            continue
        elif channel == "scan":
            names = "angle_min", "angle_increment", "time_increment"
            first, step, lag = (np.float32(laser[name]) for name in names)
            seen = Scan(value, first, step, float(laser["max_range"]), mount, lag)
            began_s = max(stamp_ns + sweep_ns(len(value), lag), 0) / 1_000_000_000
            tick = replace(tick, scan=seen, log_stamp_s=began_s if tick.log_stamp_s is None else tick.log_stamp_s)
        elif channel == "observations":
            tick = replace(tick, observations=observations_of(value))
        elif channel == "closures":
            closures = [Closure(int(row["before"]), Pose.from_array(row["motion"]), row["cov"]) for row in value]
            if any(not 0 <= closure.before < number for closure in closures):
                raise ValueError(f"a loop closure of tick {number} with no earlier one")
            tick = replace(tick, closures=tuple(closures))
    if tick is not None:
        yield tick


def _tick(stamp_ns: int, row: Any) -> Tick:
    cov, truth, own_s = row["increment_cov"], row["truth"], float(row["log_stamp_s"])
    return Tick(
        stamp_ns,
        Pose.from_array(row["odometry"]),
        increment_cov=None if np.isnan(cov).any() else cov,
        truth=None if np.isnan(truth).any() else Pose.from_array(truth),
        log_stamp_s=None if math.isnan(own_s) else own_s,
        is_unmeasured=bool(row["is_unmeasured"]),
    )


def read_messages(file: Path) -> tuple[list[Message], bool]:
    """All messages of a record, and whether it ends early: then those of its whole chunks.

    Raises InputError for a file that cannot be read, that is no record, or whose record has another format.
    """
    from mcap.exceptions import InvalidMagic
    from mcap.reader import NonSeekingReader

    rows: dict[int, np.dtype[Any]] = {}
    found: list[Message] = []
    is_cut = False
    with readable(file):
        if not file.is_file():
            raise InputError(file, "no such file", "the folder of a run of this version")
        check_regular(file)
        with file.open("rb") as stream:
            reader = NonSeekingReader(stream, validate_crcs=True, record_size_limit=_LARGEST_CHUNK)
            raw: list[Any] = []
            try:
                for each in reader.iter_messages(log_time_order=False):
                    raw.append(each)
            except InvalidMagic:
                raise InputError(file, "is not an MCAP file", "the record of a run") from None
            except Exception:  # the writer was stopped here; an incomplete record raises any exception
                is_cut = True
            for schema, channel, message in raw:
                if schema is None or schema.encoding != "rows":
                    value = json.loads(message.data)
                else:
                    if schema.id not in rows:
                        rows[schema.id] = _row_type(json.loads(schema.data))
                    value = _rows(message.data, rows[schema.id])
                found.append(Message(channel.topic, message.log_time, value))
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
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror or 'damaged'})") from None
    except Exception as error:  # a message with a valid checksum may still be invalid
        raise InputError(file, f"found {reason_of(error)}", "the record of a run") from None


def _rows(data: bytes, row: np.dtype[Any]) -> NDArray[Any]:
    """(n,) rows; none of an array without columns, such as the covariance of no landmarks."""
    return np.frombuffer(data, row) if row.itemsize else np.zeros(0, row)


def _row_type(columns: Sequence[tuple[str, str, Sequence[int]]]) -> np.dtype[Any]:
    """NumPy's type of a row, from a schema."""
    types = [(str(name), np.dtype(kind), tuple(shape)) for name, kind, shape in columns]
    if any(kind.kind not in "fiub" for _, kind, _ in types):
        raise ValueError("a column that has no numbers")
    if types[0][0] == "":
        return np.dtype(types[0][1:])
    return np.dtype(types)
