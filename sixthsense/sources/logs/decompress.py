"""Untrusted files: only regular files are opened, and the size of decompressed data is bounded."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

from sixthsense.sources.logs.errors import LogError

_LARGEST_CHUNK = 1 << 28  # bytes; writers close chunks after some millions
_BASE_BUDGET = 1 << 30  # bytes that all chunks of any bag may have together
_BUDGET_PER_BYTE = 20  # additional bytes per byte of the file; scans rarely compress to a tenth


def check_regular(path: Path) -> None:
    """Raise LogError if a path, or a file in that folder, is a pipe or a device, which may never end."""
    for file in (path, *path.iterdir()) if path.is_dir() else (path,):
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise LogError(f"{file}: is a pipe or a device, allowed: a file")


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
