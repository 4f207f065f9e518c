"""Text logs: records, tables and trajectories of a plain or compressed file; errors of a log name file and line."""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError, reason_of
from sixthsense.core.geometry import Array

LONGEST_LINE = 1 << 22  # bytes; fits the widest scan that the configuration allows, and bounds the memory
LARGEST = 1e10  # metres, radians, seconds; squares and products of larger numbers may overflow
LAST_STAMP_S = 9_000_000_000  # nanoseconds must fit into 64 bits
_BASE_BUDGET, _BUDGET_PER_BYTE = 1 << 26, 200
"""bytes that a file may hold; text of numbers compresses to a tenth, hardly to a hundredth"""
_OPENERS: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
"""by the first bytes of a compressed file"""
_SECONDS = 1e8
"""Stamps since 1970 of any log are larger: it is of 1973."""
_ALLOWED = "8 (stamp x y z qx qy qz qw), 4 (stamp x y theta), or EuRoC's, with their header"
_HINTS = {12: ", as those of KITTI, which have no stamps", 16: ", are there decimal commas?"}
_SIZES = {6: 3, 21: 6, 9: 3, 36: 6}
"""numbers of a covariance, its upper triangle or all, and its size"""


@dataclass(frozen=True, slots=True)
class Record:
    """One line of a file with its position."""

    path: Path
    """the file"""
    line: int
    """line number, from 1"""
    fields: list[bytes]
    """words of the line"""

    def fail(self, what: str) -> NoReturn:
        """Raise InputError with file and line."""
        raise InputError(f"{self.path} line {self.line}", what)

    def numbers(self, fields: Sequence[bytes], largest: float | None = LARGEST, unit: str = "") -> Array:
        """(len(fields),) finite numbers, up to `largest` in magnitude; without a limit also NaN and infinity."""
        try:
            values = np.array(fields, dtype=np.float64)
        except ValueError:
            values = np.array([self._number(field) for field in fields])
        if largest is not None and not (is_fine := np.abs(values) <= largest).all():
            self.fail(
                f"found {shown(fields[int(is_fine.argmin())])}, allowed: a finite number{unit} up to {largest:.0e}"
            )
        return values

    def _number(self, field: bytes) -> float:
        try:
            return float(field)
        except ValueError:
            comma = " with a decimal comma" * bool(re.fullmatch(rb"[-+]?\d+,\d+", field))
            self.fail(f"found {shown(field)}{comma}, allowed: a number")

    def stamp_ns(self, field: bytes, parts: int = 1) -> int:
        """Nanoseconds of a stamp in `parts` of a second, from its decimal digits; a float would round to 0.1 us."""
        self.numbers([field], LAST_STAMP_S * parts, " of seconds" * (parts == 1))
        return round(Decimal(field.decode()) / parts * 1_000_000_000)

    def whole(self, column: int, name: str) -> int:
        """A whole number, an id or a count, of 32 bits."""
        field = self.fields[column]
        if not (field.isdigit() and len(field) <= 10 and int(field) < 1 << 31):
            self.fail(f"found {name} {shown(field)}, allowed: a whole number, 0 to {(1 << 31) - 1}")
        return int(field)


def shown(field: bytes) -> str:
    """A field for an error message."""
    return repr(field[:24].decode("ascii", "backslashreplace")) + "..." * (len(field) > 24)


class Table(NamedTuple):
    """Lines of numbers, one of which is a stamp."""

    header: Sequence[bytes]
    """lines before those of numbers"""
    records: Sequence[Record]
    """(N,) lines"""
    numbers: Array
    """(N, columns)"""

    def stamps_ns(self, parts: int = 1) -> NDArray[np.int64]:
        """(N,) stamps, nanoseconds, of the first column in `parts` of a second."""
        return np.array([record.stamp_ns(record.fields[0], parts) for record in self.records], dtype=np.int64)


def read_table(path: Path, columns: str = "") -> Table:
    """A line of numbers, separated by spaces, commas or semicolons, for each record; at least one.

    Each line has a number for each word of `columns`, by default as many as the first one. Raises InputError, naming
    the line, for any other line, and for numbers that are not finite.
    """
    header: list[bytes] = []
    found: list[Record] = []
    for number, line in lines(path):
        fields = line.translate(bytes.maketrans(b",;", b"  ")).split()
        if not found and fields and not re.match(rb"[-+.0-9]|nan", fields[0]):
            header.append(line)
        elif fields and not fields[0].startswith(b"#"):
            found.append(Record(path, number, fields))
    if not found:
        raise InputError(path, "found no line of numbers", f"lines of {columns or 'numbers'}")
    width = len(columns.split() or found[0].fields)
    for record in found:
        if (count := len(record.fields)) != width:
            comma = ", are there decimal commas?" * (count == 2 * width)
            record.fail(f"found {count} fields{comma}, allowed: {width} in every line{' of ' * bool(columns)}{columns}")
    return Table(header, found, np.array([record.numbers(record.fields, 1e9 * LAST_STAMP_S) for record in found]))


def records(path: Path) -> Iterator[Record]:
    """The lines of a file as words between spaces; those that are blank or begin with # are skipped."""
    for number, line in lines(path):
        fields = line.split()
        if fields and not fields[0].startswith(b"#"):
            yield Record(path, number, fields)


def lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Number (from 1) and bytes of each line of a file; one that is compressed is known by its first bytes."""
    number = 0
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # which may never end
            raise InputError(path, "is a pipe or a device", "a file")
        with path.open("rb") as raw:
            left = _BASE_BUDGET + _BUDGET_PER_BYTE * path.stat().st_size
            stream = next((opener(raw) for magic, opener in _OPENERS.items() if raw.peek(6).startswith(magic)), raw)
            while line := stream.readline(LONGEST_LINE):
                number, left = number + 1, left - len(line)
                if left < 0 or len(line) == LONGEST_LINE:
                    raise InputError(f"{path} line {number}", "found far more text than a log of this size holds")
                if line.startswith(b"version https://git-lfs"):
                    raise InputError(path, "found a pointer of Git LFS", "the file itself, by `git lfs pull`")
                yield number, line.removeprefix(b"\xef\xbb\xbf")  # which editors of Windows put first
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except (EOFError, OSError, zlib.error, lzma.LZMAError) as error:
        raise InputError(path, f"cannot be read after line {number} ({reason_of(error)})") from None


def unit_of(stamps: Array) -> tuple[int, str]:
    """Parts of a second, and their name, that stamps since 1970 of this size are in; seconds for any others."""
    for parts, name in ((10**9, "nanoseconds"), (10**6, "microseconds"), (10**3, "milliseconds")):
        if np.abs(stamps).max(initial=0.0) > _SECONDS * parts:
            return parts, name
    return 1, "seconds"


def read_trajectory(file: Path, notes: list[str]) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and poses, (N, 7) x y z qx qy qz qw or (N, 3) x y theta; plain or compressed.

    Columns are those of TUM files, or stamp x y theta; those of EuRoC, of which more may follow, where a header has qw
    before qx. Stamps are seconds, or as large as those in a part of a second since 1970, which is said in `notes`.
    Raises InputError, naming the line, for one that has other numbers, for a quaternion of zeros, and where the header
    names columns in another order.
    """
    table = read_table(file)
    width = table.numbers.shape[1]
    header = b"".join(table.header).lower()
    is_w_first = width >= 8 and re.search(rb"q[a-z_]*w\b.*q[a-z_]*x\b", header)
    if (width not in (4, 8) and not is_w_first) or re.search(rb"\b(yaw|theta|heading|y)\b.*\bx\b", header):
        table.records[0].fail(f"found {width} fields{_HINTS.get(width, '')}, allowed: {_ALLOWED}")
    values = table.numbers[:, (1, 2, 3, 5, 6, 7, 4) if is_w_first else range(1, width)]
    is_turned = values[:, 3:].any(axis=1)
    if width > 4 and not is_turned.all():
        table.records[int(np.argmin(is_turned))].fail("found a quaternion that is zero, allowed: a rotation")
    return _stamps_ns(table, notes), values


def read_covariances(file: Path, notes: list[str]) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and covariances (N, 3, 3) or (N, 6, 6): in a line a stamp, and the upper triangle or all.

    By rows: 6 or 9 numbers are of SE(2), 21 or 36 of SE(3). Stamps and `notes` are as of `read_trajectory`. Raises
    InputError, naming the line, for any other.
    """
    table = read_table(file)
    values = table.numbers[:, 1:]
    if (count := values.shape[1]) not in _SIZES:
        table.records[0].fail(f"found {count + 1} fields, allowed: a stamp and 6, 9, 21 or 36 numbers of a covariance")
    size = _SIZES[count]
    rows, columns = np.indices((size, size)).reshape(2, -1) if count == size * size else np.triu_indices(size)
    covs = np.zeros((len(values), size, size))
    covs[:, columns, rows] = covs[:, rows, columns] = values
    return _stamps_ns(table, notes), covs


def _stamps_ns(table: Table, notes: list[str]) -> NDArray[np.int64]:
    """(N,) stamps, ns, of the first column in seconds; in another unit if they say so, with a note."""
    parts, name = unit_of(table.numbers[:, 0])
    if parts > 1:
        notes.append(f"{table.records[0].path}: stamps as large as {table.numbers[0, 0]:.0f} are taken as {name}")
    return table.stamps_ns(parts)
