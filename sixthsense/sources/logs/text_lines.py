"""Text logs: lines of a plain or compressed file, and numbers with errors that name file and line."""

from __future__ import annotations

import bz2
import gzip
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import IO, NoReturn, cast

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.sources.logs.decompress import check_regular
from sixthsense.sources.logs.errors import LogError

LONGEST_LINE = 1 << 22  # bytes; fits the widest scan that the configuration allows, and bounds the memory
LARGEST = 1e10  # metres, radians, seconds; squares and products of larger numbers may overflow
LAST_STAMP_S = 9_000_000_000  # nanoseconds must fit into 64 bits


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
        """Raise LogError with file and line."""
        raise LogError(f"{self.path} line {self.line}: {what}")

    def numbers(self, fields: list[bytes]) -> Array:
        """(len(fields),) finite numbers, up to `LARGEST` in magnitude."""
        values = self.parsed(fields)
        bad = np.flatnonzero(~(np.abs(values) <= LARGEST))
        if len(bad):
            self.fail(f"found {shown(fields[bad[0]])}, allowed: a finite number, none beyond {LARGEST:.0e}")
        return values

    def stamp_ns(self, field: bytes) -> int:
        """Nanoseconds of a stamp in seconds, from its decimal digits; a float would round to 0.1 us."""
        try:
            # Decimal accepts underscores, unlike the other fields.
            stamp = Decimal("nan" if field.strip(b"0123456789+-.eE") else field.decode())
        except InvalidOperation:
            stamp = Decimal("nan")
        if not (stamp.is_finite() and 0 <= stamp <= LAST_STAMP_S):
            self.fail(f"found stamp {shown(field)}, allowed: 0 to {LAST_STAMP_S} s")
        return round(stamp * 1_000_000_000)

    def parsed(self, fields: list[bytes]) -> Array:
        """(len(fields),) numbers, NaN and infinity included."""
        try:
            return np.array(fields, dtype=np.float64)
        except ValueError:
            for field in fields:
                if math.isnan(_number(field)):
                    self.fail(f"found {shown(field)}, allowed: a number")
            raise


def _number(field: bytes) -> float:
    try:
        return float(field)
    except ValueError:
        return math.nan


def shown(field: bytes) -> str:
    """A field for an error message."""
    text = field.decode("ascii", "backslashreplace")
    return repr(text if len(text) <= 24 else text[:24] + "...")


def lines(path: Path) -> Iterator[tuple[int, bytes]]:
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
                if len(line) == LONGEST_LINE:
                    raise LogError(f"{path} line {number}: found a line of over {LONGEST_LINE} bytes, allowed: text")
                yield number, line
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except EOFError:
        raise LogError(f"{path}: is cut short, its compressed data ends after line {number}") from None
    except (OSError, zlib.error) as error:
        reason = (isinstance(error, OSError) and error.strerror) or f"damaged after line {number}: {error}"
        raise LogError(f"{path}: cannot be read ({reason})") from None
