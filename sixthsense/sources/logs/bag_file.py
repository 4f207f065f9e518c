"""Bags are untrusted files: only regular ones are opened, and the size of decompressed data is bounded."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import IO, TYPE_CHECKING, Any

from sixthsense.config.errors import InputError
from sixthsense.sources.logs.errors import LogError, check_regular

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_LARGEST_STAMP_NS = 9_000_000_000 * 1_000_000_000  # nanoseconds must fit into 64 bits
_LONGEST_REASON = 160  # letters
_LARGEST_CHUNK = 1 << 28  # bytes; writers close chunks after some millions
_BASE_BUDGET = 1 << 30  # bytes that all chunks of any bag may have together
_BUDGET_PER_BYTE = 20  # additional bytes per byte of the file; scans rarely compress to a tenth


@contextmanager
def opened(path: Path) -> Iterator[AnyReader]:
    """The reader of a bag: ROS 1 (.bag), or ROS 2 (a folder with metadata.yaml, an .mcap or a .db3 file).

    Whatever is wrong within the block is a LogError: a damaged bag can raise any exception, and may define a type with
    a known name but without the expected fields.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if not path.exists():
        raise LogError(f"{path}: no such file")
    try:
        check_regular(path)
        _check_first_line(path)
        with bounded(path), AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        if len(reason) > _LONGEST_REASON:
            reason = reason[:_LONGEST_REASON] + "..."
        raise LogError(
            f"{path}: cannot be read as a bag ({reason}), allowed: ROS 1 .bag, ROS 2 folder or file"
        ) from None


def _check_first_line(path: Path) -> None:
    """Raise ValueError for a ROS 1 bag with an endless first line, which the reader would read as a whole."""
    if path.suffix.lower() == ".bag" and path.is_file():
        with path.open("rb") as stream:
            if not stream.readline(32).endswith(b"\n"):
                raise ValueError("File magic is invalid.")


def checked_stamp(where: str, stamp_ns: int) -> int:
    """A stamp that fits into 64 bits; LogError for any other."""
    if not 0 <= stamp_ns <= _LARGEST_STAMP_NS:
        raise LogError(f"{where}: found stamp {stamp_ns} ns, allowed: 0 to {_LARGEST_STAMP_NS} ns")
    return stamp_ns


@contextmanager
def bounded(path: Path) -> Iterator[None]:
    """A context in which rosbags raises ValueError if one chunk of a bag, or all of them together, get too large.

    rosbags decompresses a chunk again whenever messages of two chunks alternate, so the bound on the sum also bounds
    the time.
    """
    from rosbags.rosbag1 import reader as reader1
    from rosbags.rosbag2 import reader as reader2
    from rosbags.rosbag2 import storage_mcap

    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    left = _BASE_BUDGET + _BUDGET_PER_BYTE * sum(file.stat().st_size for file in files)

    def charge(data: bytes, _: int = 0) -> bytes:
        nonlocal left
        left -= len(data)
        if len(data) > _LARGEST_CHUNK:
            raise ValueError(f"found a chunk of over {_LARGEST_CHUNK} bytes")
        if left < 0:
            raise ValueError("found chunks that hold far more than the file")
        return data

    def decompressor(name: str) -> Callable[..., bytes]:
        return lambda data, _=0: charge(decompressed(data, name))

    @contextmanager
    def opened(stream: IO[bytes], mode: str) -> Iterator[Any]:
        with reading(stream, mode) as inner:
            yield SimpleNamespace(read=lambda size: charge(inner.read(size)))

    reading = vars(reader2)["zstd"].open
    tables: tuple[tuple[dict[str, Any], dict[str, Any]], ...] = (
        (
            storage_mcap.DECOMPRESSORS,
            {"": charge, "lz4": decompressor("lz4"), "zstd": decompressor("zstd")},
        ),
        (
            reader1.decompressors,
            {"none": charge, "lz4": decompressor("lz4"), "bz2": decompressor("bz2")},
        ),
        (vars(reader2), {"zstd": SimpleNamespace(decompress=decompressor("zstd"), open=opened)}),
    )
    before = [{name: table[name] for name in replacements} for table, replacements in tables]
    for table, replacements in tables:
        table.update(replacements)
    try:
        yield
    finally:
        for (table, _), originals in zip(tables, before, strict=True):
            table.update(originals)


def decompressed(data: bytes, compression: str) -> bytes:
    """Decompress concatenated bz2, lz4 or zstd streams; an empty `compression` returns the data unchanged.

    Raises ValueError for more data than a chunk may hold, for truncated data and for an unknown compression.
    """
    from backports import zstd
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

    if not compression:
        return data
    kinds: dict[str, Callable[[], Any]] = {
        "bz2": bz2.BZ2Decompressor, "lz4": LZ4FrameDecompressor, "zstd": zstd.ZstdDecompressor
    }  # fmt: skip
    if compression not in kinds:
        raise ValueError(f"found the compression {compression!r}, allowed: {', '.join(kinds)}")
    parts: list[bytes] = []
    size, rest = 0, data
    while rest:
        stream = kinds[compression]()
        parts.append(stream.decompress(rest, _LARGEST_CHUNK + 1 - size))
        size += len(parts[-1])
        if size > _LARGEST_CHUNK:
            raise ValueError(f"found a chunk of over {_LARGEST_CHUNK} bytes")
        if not stream.eof:
            raise ValueError("found compressed data that is cut short")
        rest = stream.unused_data
    return b"".join(parts)
