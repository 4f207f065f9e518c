"""Text logs: records, tables and trajectories of a plain or compressed file; errors of a log name file and line."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import IO, NamedTuple, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.sources.logs.stamps import unit_of

LONGEST_LINE = 1 << 22  # bytes; fits the widest scan that the configuration allows, and bounds the memory
LARGEST = 1e10  # metres, radians, seconds; squares and products of larger numbers may overflow
LAST_STAMP_S = 9_000_000_000  # nanoseconds must fit into 64 bits
_LARGEST_STAMP = 1e9 * LAST_STAMP_S  # of any unit
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"  # which editors of Windows put first
_LARGEST_WHOLE = (1 << 31) - 1
_TRIANGLES = {6: 3, 21: 6}
"""numbers of the upper triangle of a covariance, and its size"""


def check_regular(path: Path) -> None:
    """Raise InputError if a path, or a file in that folder, is a pipe or a device, which may never end."""
    for file in (path, *path.iterdir()) if path.is_dir() else (path,):
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise InputError(file, "is a pipe or a device", "a file")


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

    def numbers(self, fields: list[bytes], largest: float = LARGEST) -> Array:
        """(len(fields),) finite numbers, up to `largest` in magnitude."""
        values = self.parsed(fields)
        bad = np.flatnonzero(~(np.abs(values) <= largest))
        if len(bad):
            self.fail(f"found {shown(fields[bad[0]])}, allowed: a finite number, none beyond {largest:.0e}")
        return values

    def stamp_ns(self, field: bytes, parts: int = 1) -> int:
        """Nanoseconds of a stamp in `parts` of a second, from its decimal digits; a float would round to 0.1 us."""
        try:
            # Decimal accepts underscores, unlike the other fields.
            stamp = Decimal("nan" if field.strip(b"0123456789+-.eE") else field.decode()) / parts
        except InvalidOperation:
            stamp = Decimal("nan")
        if not (stamp.is_finite() and abs(stamp) <= LAST_STAMP_S):
            self.fail(f"found stamp {shown(field)}, allowed: {-LAST_STAMP_S} to {LAST_STAMP_S} s")
        return round(stamp * 1_000_000_000)

    def whole(self, column: int, name: str) -> int:
        """A whole number, an id or a count, of 32 bits."""
        field = self.fields[column]
        if not field.isdigit() or len(field) > 10 or int(field) > _LARGEST_WHOLE:
            self.fail(f"found {name} {shown(field)}, allowed: a whole number, 0 to {_LARGEST_WHOLE}")
        return int(field)

    def parsed(self, fields: list[bytes]) -> Array:
        """(len(fields),) numbers, NaN and infinity included."""
        try:
            return np.array(fields, dtype=np.float64)
        except ValueError:
            self.fail(f"found {shown(next(field for field in fields if not _is_number(field)))}, allowed: a number")


def _is_number(field: bytes) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def shown(field: bytes) -> str:
    """A field for an error message."""
    text = field.decode("ascii", "backslashreplace")
    return repr(text if len(text) <= 24 else text[:24] + "...")


class Table(NamedTuple):
    """Lines of numbers."""

    records: list[Record]
    numbers: Array
    """(N, columns)"""

    def stamps_ns(self, notes: list[str] | None = None) -> NDArray[np.int64]:
        """(N,) stamps, nanoseconds, of the first column in seconds; in another unit if they say so, with a note."""
        parts, name = unit_of(self.numbers[:, 0])
        if parts > 1 and notes is not None:
            notes.append(f"{self.records[0].path}: stamps as large as {self.numbers[0, 0]:.0f} are taken as {name}")
        return np.array([record.stamp_ns(record.fields[0], parts) for record in self.records], dtype=np.int64)

    def check(self, column: int, name: str, low: float, high: float) -> None:
        """Fail at the first line with a number outside [low, high] in a column."""
        values = self.numbers[:, column]
        bad = np.flatnonzero((values < low) | (values > high))
        if len(bad):
            record = self.records[bad[0]]
            record.fail(f"found {name} {shown(record.fields[column])}, allowed: {low:g} to {high:g}")


def read_table(path: Path, columns: str, widths: Sequence[int] = (), first_up_to: float = LARGEST) -> Table:
    """A line of numbers, separated by spaces or commas, for each record; at least one.

    All lines have the same width: one of `widths`, by default the number of words in `columns`. Raises InputError,
    naming the line, for any other line, and for numbers that are not finite or beyond `LARGEST`, `first_up_to` in the
    first column.
    """
    widths = widths or (len(columns.split()),)
    found: list[Record] = []
    for record in records(path, b","):
        count = len(record.fields)
        if count not in widths or (found and count != len(found[0].fields)):
            record.fail(f"found {count} fields, allowed: {' or '.join(map(str, widths))} in every line ({columns})")
        found.append(record)
    if not found:
        raise InputError(path, "found no line of numbers", f"lines of {columns}")
    try:
        numbers = np.array([record.fields for record in found], dtype=np.float64)
    except ValueError:
        numbers = np.full((len(found), len(found[0].fields)), np.nan)
    largest = np.array([first_up_to] + [LARGEST] * (numbers.shape[1] - 1))
    if not (np.abs(numbers) <= largest).all():
        for record in found:
            record.numbers(record.fields[:1], first_up_to)  # says what is wrong in the first bad line
            record.numbers(record.fields[1:])
    return Table(found, numbers)


def read_tum(file: Path, notes: list[str] | None = None) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and poses (N, 7), x y z qx qy qz qw, of a TUM trajectory; plain, gzip or bzip2.

    Lines that are empty or begin with # are skipped. Stamps are seconds, or as large as those in a part of a second
    since 1970, which is said in `notes`. Raises InputError, naming the line, for any other line than one of eight
    finite numbers, for a quaternion that is zero, and for a file without a pose.
    """
    table = read_table(file, "stamp x y z qx qy qz qw", first_up_to=_LARGEST_STAMP)
    zero = np.flatnonzero(~np.any(table.numbers[:, 4:], axis=1))
    if len(zero):
        table.records[zero[0]].fail("found a quaternion that is zero, allowed: a rotation")
    return table.stamps_ns(notes), table.numbers[:, 1:]


def read_covariances(file: Path, notes: list[str] | None = None) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and covariances (N, 3, 3) or (N, 6, 6): a stamp and the upper triangle, row by row, in a line.

    6 numbers are of SE(2), 21 of SE(3). Stamps are as of `read_tum`. Raises InputError, naming the line, for any other.
    """
    lengths = [1 + count for count in _TRIANGLES]
    table = read_table(file, "a stamp and the upper triangle", lengths, _LARGEST_STAMP)
    values = table.numbers[:, 1:]
    size = _TRIANGLES[values.shape[1]]
    rows, columns = np.triu_indices(size)
    covs = np.zeros((len(values), size, size))
    covs[:, rows, columns] = covs[:, columns, rows] = values
    return table.stamps_ns(notes), covs


def records(path: Path, separator: bytes = b" ") -> Iterator[Record]:
    """The lines of a file as words between spaces, or `separator`; those that are blank or begin with # are skipped."""
    for number, line in _lines(path):
        fields = line.replace(separator, b" ").split()
        if fields and not fields[0].startswith(b"#"):
            yield Record(path, number, fields)


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Number (from 1) and bytes of each line of a plain, gzip or bzip2 file, by its first bytes."""
    number = 0
    try:
        check_regular(path)
        with path.open("rb") as raw:
            magic = raw.peek(3)[:3]
            stream: IO[bytes] = raw
            if magic[:2] == b"\x1f\x8b":
                stream = cast(IO[bytes], gzip.GzipFile(fileobj=raw))
            elif magic == b"BZh":
                stream = bz2.BZ2File(raw)
            while line := stream.readline(LONGEST_LINE):
                number += 1
                line = line.removeprefix(_BYTE_ORDER_MARK) if number == 1 else line
                if len(line) == LONGEST_LINE:
                    raise InputError(f"{path} line {number}", f"found a line of over {LONGEST_LINE} bytes", "text")
                yield number, line
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except EOFError:
        raise InputError(path, f"is cut short, its compressed data ends after line {number}") from None
    except (OSError, zlib.error) as error:
        reason = (isinstance(error, OSError) and error.strerror) or f"damaged after line {number}: {error}"
        raise InputError(path, f"cannot be read ({reason})") from None
