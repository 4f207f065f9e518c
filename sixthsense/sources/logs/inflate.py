"""Files of others before they are trusted: only regular ones are opened, and what they decompress to is bounded."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

from sixthsense.sources.logs import LogError

_LARGEST_CHUNK = 1 << 28  # bytes; writers close theirs after some millions
_ALWAYS = 1 << 30  # bytes that all chunks of a bag may have together, however small it is
_PER_BYTE = 20  # and for each byte of it; scans seldom shrink to a tenth


def check_regular(path: Path) -> None:
    """Raise LogError if a path, or a file in the folder that it names, is a pipe or a device, which may never end."""
    for file in (path, *path.iterdir()) if path.is_dir() else (path,):
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise LogError(f"{file}: is a pipe or a device, allowed: a file")


@contextmanager
def bounded(path: Path) -> Iterator[None]:
    """Within it rosbags raises ValueError where a chunk of a bag, or all that it decompresses, would fill the memory.

    It reads a chunk as often as messages of two chunks alternate, so that a bound on the sum is one on the time too.
    """
    from rosbags.rosbag1 import reader as reader1
    from rosbags.rosbag2 import reader as reader2
    from rosbags.rosbag2 import storage_mcap

    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    left = _ALWAYS + _PER_BYTE * sum(file.stat().st_size for file in files)

    def spent(data: bytes, _: int = 0) -> bytes:
        nonlocal left
        left -= len(data)
        if len(data) > _LARGEST_CHUNK:
            raise ValueError(f"found a chunk of over {_LARGEST_CHUNK} bytes")
        if left < 0:
            raise ValueError("found chunks that hold far more than the file")
        return data

    def by(name: str) -> Callable[..., bytes]:
        return lambda data, _=0: spent(inflated(data, name))

    @contextmanager
    def opened(stream: IO[bytes], mode: str) -> Iterator[Any]:
        with reading(stream, mode) as inner:
            yield SimpleNamespace(read=lambda size: spent(inner.read(size)))

    reading = vars(reader2)["zstd"].open
    tables: tuple[tuple[dict[str, Any], dict[str, Any]], ...] = (
        (storage_mcap.DECOMPRESSORS, {"": spent, "lz4": by("lz4"), "zstd": by("zstd")}),
        (reader1.decompressors, {"none": spent, "lz4": by("lz4"), "bz2": by("bz2")}),
        (vars(reader2), {"zstd": SimpleNamespace(decompress=by("zstd"), open=opened)}),
    )
    before = [{name: table[name] for name in ours} for table, ours in tables]
    for table, ours in tables:
        table.update(ours)
    try:
        yield
    finally:
        for (table, _), theirs in zip(tables, before, strict=True):
            table.update(theirs)


def inflated(data: bytes, compression: str) -> bytes:
    """What streams compressed by bz2, lz4 or zstd, one after the other, hold; data as it is if by nothing.

    Raises ValueError for more than a chunk may hold, and for data that is cut short or compressed in another way.
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
