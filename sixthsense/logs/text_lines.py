"""Text logs: records and tables of a plain or compressed file; errors of a log name file and line."""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from io import BufferedReader
from pathlib import Path
from typing import IO, NamedTuple, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.logs.stamps import unit_of

LONGEST_LINE = 1 << 22  # bytes; fits the widest scan that the configuration allows, and bounds the memory
LARGEST = 1e10  # metres, radians, seconds; squares and products of larger numbers may overflow
LAST_STAMP_S = 9_000_000_000  # nanoseconds must fit into 64 bits
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"  # which editors of Windows put first
_BASE_BUDGET, _BUDGET_PER_BYTE = 1 << 26, 200
"""bytes that a compressed file may hold; text of numbers compresses to a tenth, hardly to a hundredth"""
_LFS = b"version https://git-lfs"


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

    def numbers(self, fields: Sequence[bytes], largest: float = LARGEST) -> Array:
        """(len(fields),) finite numbers, up to `largest` in magnitude."""
        values = self.parsed(fields)
        bad = np.flatnonzero(~(np.abs(values) <= largest))
        if len(bad):
            self.fail(f"found {shown(fields[bad[0]])}, allowed: a finite number, none beyond {largest:.0e}")
        return values

    def parsed(self, fields: Sequence[bytes]) -> Array:
        """(len(fields),) numbers, NaN and infinity included."""
        try:
            return np.array(fields, dtype=np.float64)
        except ValueError:
            field = next(field for field in fields if not _is_number(field))
            comma = " with a decimal comma" * bool(re.fullmatch(rb"[-+]?\d+,\d+", field))
            self.fail(f"found {shown(field)}{comma}, allowed: a number")

    def stamp_ns(self, field: bytes, parts: int = 1) -> int:
        """Nanoseconds of a stamp in `parts` of a second, from its decimal digits; a float would round to 0.1 us."""
        try:
            stamp = Decimal(field.decode("ascii", "replace")) / parts
        except InvalidOperation:
            stamp = Decimal("nan")
        if not (stamp.is_finite() and abs(stamp) <= LAST_STAMP_S):
            self.fail(f"found stamp {shown(field)}, allowed: {-LAST_STAMP_S} to {LAST_STAMP_S} s")
        return round(stamp * 1_000_000_000)

    def whole(self, column: int, name: str) -> int:
        """A whole number, an id or a count, of 32 bits."""
        field = self.fields[column]
        if not (field.isdigit() and len(field) <= 10 and int(field) < 1 << 31):
            self.fail(f"found {name} {shown(field)}, allowed: a whole number, 0 to {(1 << 31) - 1}")
        return int(field)


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
    """Lines of numbers, the first of which is a stamp."""

    records: list[Record]
    numbers: Array
    """(N, columns)"""

    def stamps_ns(self, notes: list[str] | None = None, column: int = 0) -> NDArray[np.int64]:
        """(N,) stamps, nanoseconds, of a column in seconds; in another unit if they say so, with a note."""
        parts, name = unit_of(self.numbers[:, column])
        if parts > 1 and notes is not None:
            largest = self.numbers[0, column]
            notes.append(f"{self.records[0].path}: stamps as large as {largest:.0f} are taken as {name}")
        return np.array([record.stamp_ns(record.fields[column], parts) for record in self.records], dtype=np.int64)


def read_table(path: Path, columns: str) -> Table:
    """A line of numbers, separated by spaces, commas or semicolons, for each record; at least one.

    Each line has a number for each word of `columns`. Raises InputError, naming the line, for any other line, and for
    numbers that are not finite or beyond `LARGEST`.
    """
    width = len(columns.split())
    found = list(records(path, b",;"))
    if not found:
        raise InputError(path, "found no line of numbers", f"lines of {columns}")
    return Table(found, np.array([numbers_of(record, width, columns) for record in found]))


def numbers_of(record: Record, width: int, columns: str = "", largest: float = LARGEST) -> Array:
    """(width,) the numbers of a line, up to `largest`; InputError, naming the line, for any other line."""
    if (count := len(record.fields)) != width:
        comma = ", are there decimal commas?" * (count == 2 * width)
        record.fail(f"found {count} fields{comma}, allowed: {width} in every line{f' ({columns})' * bool(columns)}")
    return record.numbers(record.fields, largest)


def first_word(file: Path) -> bytes:
    """The first word of a text that is no comment; empty where there is none, and for a file that cannot be read."""
    try:
        return next((record.fields[0] for record in records(file)), b"")
    except InputError:
        return b""


def records(path: Path, separators: bytes = b"") -> Iterator[Record]:
    """The lines of a file as words between spaces or separators; those that are blank or begin with # are skipped."""
    for number, line in lines(path):
        fields = words(line, separators)
        if fields and not fields[0].startswith(b"#"):
            yield Record(path, number, fields)


def words(line: bytes, separators: bytes) -> list[bytes]:
    """What stands between spaces, or any of these separators."""
    return line.translate(bytes.maketrans(separators, b" " * len(separators))).split()


def lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Number (from 1) and bytes of each line of a file; one that is compressed is known by its first bytes."""
    number = 0
    try:
        check_regular(path)
        with path.open("rb") as raw:
            stream = _decompressed(raw)
            left = _BASE_BUDGET + _BUDGET_PER_BYTE * path.stat().st_size
            while line := stream.readline(LONGEST_LINE):
                number += 1
                left -= len(line) if stream is not raw else 0
                if left < 0:
                    raise InputError(path, "found far more text than a compressed log of this size holds", "a log")
                if line.startswith(_LFS):
                    raise InputError(path, "found a pointer of Git LFS", "the file itself, by `git lfs pull`")
                if len(line) == LONGEST_LINE:
                    raise InputError(f"{path} line {number}", f"found a line of over {LONGEST_LINE} bytes", "text")
                yield number, line.removeprefix(_BYTE_ORDER_MARK)
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except EOFError:
        raise InputError(path, f"is cut short, its compressed data ends after line {number}") from None
    except (OSError, zlib.error, lzma.LZMAError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or f"damaged after line {number}: {error}"
        raise InputError(path, f"cannot be read ({reason})") from None


def _decompressed(raw: BufferedReader) -> IO[bytes]:
    """The content of a file, by its first bytes: gzip, bzip2, xz, or as it is."""
    magic = raw.peek(6)[:6]
    if magic.startswith(b"\x1f\x8b"):
        return cast(IO[bytes], gzip.GzipFile(fileobj=raw))
    if magic.startswith(b"BZh"):
        return bz2.BZ2File(raw)
    if magic.startswith(b"\xfd7zXZ"):
        return lzma.LZMAFile(raw)
    return raw
