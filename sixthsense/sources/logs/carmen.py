"""CARMEN logs: one text line per odometry record or laser scan."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.text_lines import LARGEST, Record, lines, shown

_ODOM_FIELDS = 10
"""ODOM x y theta tv rv accel ipc_time host logger_time"""
_FLASER_FIELDS = 11
"""FLASER n (here the n ranges) x y theta odom_x odom_y odom_theta ipc_time host logger_time"""
_MESSAGE_NAME = re.compile(rb"[A-Z][A-Z0-9_-]{0,39}")


def read_carmen(file: str | Path, laser: LaserConfig) -> Log:
    """Read a CARMEN log: plain, gzip or bzip2, recognised by the first bytes.

    Every FLASER line must have `laser.beams` ranges in metres; those at or beyond `laser.max_range` are no returns. The
    laser is mounted at `laser.mount`, and the odometry of a FLASER line is that of the robot (`odom_*`). Ticks keep the
    order of the file: each has the stamp of its record, or 1 ns after the previous tick if that is later. Messages
    other than ODOM and FLASER are skipped. Raises LogError for a file that cannot be read, is damaged or truncated, is
    not a CARMEN log, or has no FLASER line.
    """
    path = Path(file)
    ticks: list[Tick] = []
    kinds: Counter[bytes] = Counter()
    stamp_ns = -1
    for number, line in lines(path):
        fields = line.split()
        if not fields or fields[0].startswith(b"#"):
            continue
        record = Record(path, number, fields)
        kind = fields[0]
        scan = None
        if kind == b"FLASER":
            ranges = _ranges(record, laser.beams, first=not kinds[kind])
            scan = Scan.from_config(ranges, laser)
        elif kind == b"ODOM":
            _expect(record, _ODOM_FIELDS)
        elif not _MESSAGE_NAME.fullmatch(kind):
            record.fail(f"found {shown(kind)}, allowed: a CARMEN message, as ODOM or FLASER")
        elif b"FLASER".startswith(kind) or b"ODOM".startswith(kind):
            record.fail(f"found {shown(kind)}, a CARMEN line cut short")
        kinds[kind] += 1
        if kind not in (b"FLASER", b"ODOM"):
            continue
        odometry = Pose.from_array(record.numbers(fields[-6:-3] if scan is not None else fields[1:4]))
        stamp_ns = max(record.stamp_ns(fields[-3]), stamp_ns + 1)
        ticks.append(Tick(stamp_ns, odometry, scan, log_stamp_s=None if scan is None else float(fields[-3])))
    if not kinds[b"FLASER"]:
        found = ", ".join(f"{count} {kind.decode()}" for kind, count in kinds.most_common(5) if count)
        raise LogError(f"{path}: found no FLASER line ({found or 'no line at all'}), allowed: a log with laser scans")
    return Log(ticks)


def _expect(record: Record, count: int, what: str = "") -> None:
    kind = record.fields[0].decode() + what
    if len(record.fields) < count:
        record.fail(f"found {kind} of {len(record.fields)} fields, allowed: {count} (a CARMEN line cut short)")
    if len(record.fields) > count:
        record.fail(f"found {kind} of {len(record.fields)} fields, allowed: {count}")


def _ranges(record: Record, beams: int, first: bool) -> Array:
    """(beams,) metres, at least 0, or inf; `first` for the first scan of the log."""
    if len(record.fields) < 2:
        record.fail("found FLASER without ranges, a CARMEN line cut short")
    if not record.fields[1].isdigit() or len(record.fields[1]) > 12:
        record.fail(f"found {shown(record.fields[1])} ranges in FLASER, allowed: {beams}")
    count = int(record.fields[1])
    _expect(record, count + _FLASER_FIELDS, f" with {count} ranges")
    if count != beams:
        hint = f"laser.beams; for this log use --laser.beams {count}" if first and count > 1 else "as before"
        record.fail(f"found FLASER with {count} ranges, allowed: {beams} ({hint})")
    values = record.parsed(record.fields[2 : 2 + count])
    bad = np.flatnonzero(~(values >= 0.0))
    if len(bad):
        record.fail(f"found range {shown(record.fields[2 + bad[0]])}, allowed: metres, at least 0")
    values[values > LARGEST] = np.inf  # these may overflow a float32
    return values
