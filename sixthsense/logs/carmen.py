"""CARMEN logs: odometry and laser scans, a text line each, and the hand-checked relations that judge a run on them."""

from __future__ import annotations

import bz2
import gzip
import itertools
import math
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import IO, NoReturn, cast

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.geometry import Array, Pose, wrap_angle
from sixthsense.laser import Scan
from sixthsense.logs import LogError
from sixthsense.source import Command, Tick

_ODOM_FIELDS = 10
"""ODOM x y theta tv rv accel ipc_time host logger_time"""
_FLASER_FIELDS = 11
"""FLASER n (here the n ranges) x y theta odom_x odom_y odom_theta ipc_time host logger_time"""
_MESSAGE_NAME = re.compile(rb"[A-Z][A-Z0-9_-]*")
_LONGEST_LINE = 1 << 22  # bytes; the widest scan the configuration allows fits, binary noise fills no memory
_LAST_STAMP_S = 9_000_000_000  # whole nanoseconds must fit into 64 bits


class CarmenLog:
    """A `Source` that replays a CARMEN log: one tick per ODOM or FLASER line, in the order of the file."""

    ticks: tuple[Tick, ...]
    """The whole log."""
    scans: tuple[Scan, ...]
    """The scans of those ticks that have one."""
    backward_stamps: int
    """How many scans have a stamp of their own that is earlier than that of the scan before."""

    def __init__(self, ticks: Sequence[Tick]) -> None:
        """Make a log of at least one tick, with ascending `stamp_ns`."""
        self.ticks = tuple(ticks)
        self.scans = tuple(tick.scan for tick in self.ticks if tick.scan is not None)
        own = [tick.log_stamp_s for tick in self.ticks if tick.log_stamp_s is not None]
        self.backward_stamps = sum(later < earlier for earlier, later in itertools.pairwise(own))
        self._next = 0

    @property
    def start(self) -> Pose:
        """The first odometry pose, `T_odom_robot`."""
        return self.ticks[0].odometry

    @property
    def duration_s(self) -> float:
        """From the first tick to the last, record time, seconds."""
        return (self.ticks[-1].stamp_ns - self.ticks[0].stamp_ns) * 1e-9

    def rewind(self) -> None:
        """Begin again at the first tick."""
        self._next = 0

    def step(self, command: Command) -> Tick | None:
        """Hand out the next tick, None at the end; a recorded robot takes no command."""
        if self._next == len(self.ticks):
            return None
        self._next += 1
        return self.ticks[self._next - 1]


def read_carmen(file: str | Path, laser: LaserConfig) -> CarmenLog:
    """Read a CARMEN log: plain, gzip or bzip2, which the first bytes tell, whatever the name.

    Every FLASER line must have `laser.beams` ranges in metres; those at or beyond `laser.max_range` mean no return.
    The laser's place on the robot is `laser.mount`, the odometry of a FLASER line the robot's (its `odom_*`). The order
    of the file is the log's clock: a record's stamp is its own, or 1 ns after the one before if that is later.
    Messages other than ODOM and FLASER are passed over. Raises LogError for a file that cannot be read, is damaged or
    cut short, is not a CARMEN log, or has no FLASER line.
    """
    path = Path(file)
    ticks: list[Tick] = []
    kinds: Counter[bytes] = Counter()
    stamp_ns = -1
    for number, line in _lines(path):
        fields = line.split()
        if not fields or fields[0].startswith(b"#"):
            continue
        record = _Record(path, number, fields)
        kind = fields[0]
        scan = None
        if kind == b"FLASER":
            ranges = record.ranges(laser.beams, first=not kinds[kind])
            scan = Scan.from_config(ranges, laser)
        elif kind == b"ODOM":
            record.expect(_ODOM_FIELDS)
        elif not _MESSAGE_NAME.fullmatch(kind):
            record.fail(f"found {_shown(kind)}, allowed: a CARMEN message, as ODOM or FLASER")
        elif b"FLASER".startswith(kind) or b"ODOM".startswith(kind):
            record.fail(f"found {_shown(kind)}, a CARMEN line cut short")
        kinds[kind] += 1
        if kind not in (b"FLASER", b"ODOM"):
            continue
        odometry = Pose.from_array(record.numbers(fields[-6:-3] if scan is not None else fields[1:4]))
        stamp_ns = max(record.stamp_ns(fields[-3]), stamp_ns + 1)
        ticks.append(Tick(stamp_ns, odometry, scan, log_stamp_s=None if scan is None else float(fields[-3])))
    if not kinds[b"FLASER"]:
        found = ", ".join(f"{count} {kind.decode()}" for kind, count in kinds.most_common(5) if count)
        raise LogError(f"{path}: found no FLASER line ({found or 'no line at all'}), allowed: a log with laser scans")
    return CarmenLog(ticks)


@dataclass(frozen=True, slots=True)
class Relations:
    """Relative poses of a robot at pairs of stamps, checked by hand (Kümmerle et al., Autonomous Robots 2009)."""

    stamps: Array
    """(R, 2) seconds: the scans' own stamps, t1 and t2"""
    poses: Array
    """(R, 3) metres, radians: the robot at t2 seen from the robot at t1"""


def read_relations(file: str | Path) -> Relations:
    """Read relations, lines of `t1 t2 dx dy dz roll pitch yaw`; blank lines and lines that begin with # are skipped.

    Seconds, metres, radians; the motion is planar, so dz, roll and pitch are not used. Raises LogError for a file that
    cannot be read, a line that is not eight finite numbers, or a file without a relation.
    """
    path = Path(file)
    rows: list[Array] = []
    for number, line in _lines(path):
        fields = line.split()
        if not fields or fields[0].startswith(b"#"):
            continue
        record = _Record(path, number, fields)
        if len(fields) != 8:
            record.fail(f"found {len(fields)} fields, allowed: 8 (t1 t2 dx dy dz roll pitch yaw)")
        rows.append(record.numbers(fields))
    if not rows:
        raise LogError(f"{path}: found no relation, allowed: lines of t1 t2 dx dy dz roll pitch yaw")
    table = np.stack(rows)
    poses = np.stack([table[:, 2], table[:, 3], wrap_angle(table[:, 7])], axis=1)
    return Relations(table[:, :2].copy(), poses)


@dataclass(frozen=True, slots=True)
class _Record:
    """One line of a file, which knows where it stands."""

    path: Path
    line: int
    fields: list[bytes]

    def fail(self, what: str) -> NoReturn:
        raise LogError(f"{self.path} line {self.line}: {what}")

    def expect(self, count: int, what: str = "") -> None:
        kind = self.fields[0].decode() + what
        if len(self.fields) < count:
            self.fail(f"found {kind} of {len(self.fields)} fields, allowed: {count} (a CARMEN line cut short)")
        if len(self.fields) > count:
            self.fail(f"found {kind} of {len(self.fields)} fields, allowed: {count}")

    def numbers(self, fields: list[bytes]) -> Array:
        """(len(fields),) finite numbers."""
        values = self._parsed(fields)
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            self.fail(f"found {_shown(fields[bad[0]])}, allowed: a finite number")
        return values

    def ranges(self, beams: int, first: bool) -> Array:
        """(beams,) metres, each at least 0, or inf; `first` if no scan was read before."""
        if len(self.fields) < 2:
            self.fail("found FLASER without ranges, a CARMEN line cut short")
        if not self.fields[1].isdigit() or len(self.fields[1]) > 12:
            self.fail(f"found {_shown(self.fields[1])} ranges in FLASER, allowed: {beams}")
        count = int(self.fields[1])
        self.expect(count + _FLASER_FIELDS, f" with {count} ranges")
        if count != beams:
            hint = f"laser.beams; for this log use --laser.beams {count}" if first and count > 1 else "as before"
            self.fail(f"found FLASER with {count} ranges, allowed: {beams} ({hint})")
        values = self._parsed(self.fields[2 : 2 + count])
        bad = np.flatnonzero(~(values >= 0.0))
        if len(bad):
            self.fail(f"found range {_shown(self.fields[2 + bad[0]])}, allowed: metres, at least 0")
        return values

    def stamp_ns(self, field: bytes) -> int:
        """Whole nanoseconds of a stamp in seconds, taken from its digits: a float is good to 0.1 us only."""
        try:
            stamp = Decimal(field.decode("ascii", "replace"))
        except InvalidOperation:
            stamp = Decimal("nan")
        if not (stamp.is_finite() and 0 <= stamp <= _LAST_STAMP_S):
            self.fail(f"found stamp {_shown(field)}, allowed: 0 to {_LAST_STAMP_S} s")
        return round(stamp * 1_000_000_000)

    def _parsed(self, fields: list[bytes]) -> Array:
        try:
            return np.array(fields, dtype=np.float64)
        except ValueError:
            for field in fields:
                if math.isnan(_number(field)):
                    self.fail(f"found {_shown(field)}, allowed: a number")
            raise


def _number(field: bytes) -> float:
    try:
        return float(field)
    except ValueError:
        return math.nan


def _shown(field: bytes) -> str:
    text = field.decode("ascii", "backslashreplace")
    return repr(text if len(text) <= 24 else text[:24] + "...")


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Number (from 1) and bytes of each line of a plain, gzip or bzip2 file."""
    number = 0
    try:
        with path.open("rb") as raw:
            magic = raw.peek(3)[:3]
            stream: IO[bytes] = raw
            if magic[:2] == b"\x1f\x8b":
                stream = cast(IO[bytes], gzip.GzipFile(fileobj=raw))
            elif magic == b"BZh":
                stream = bz2.BZ2File(raw)
            while line := stream.readline(_LONGEST_LINE):
                number += 1
                if len(line) == _LONGEST_LINE:
                    raise LogError(f"{path} line {number}: found a line of over {_LONGEST_LINE} bytes, allowed: text")
                yield number, line
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except EOFError:
        raise LogError(f"{path}: is cut short, its compressed data ends after line {number}") from None
    except (OSError, zlib.error) as error:
        reason = (isinstance(error, OSError) and error.strerror) or f"damaged after line {number}: {error}"
        raise LogError(f"{path}: cannot be read ({reason})") from None
