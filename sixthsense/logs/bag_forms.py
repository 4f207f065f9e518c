"""Bags in the forms that people have them: under other names, in pieces, without metadata, or cut short."""

from __future__ import annotations

import re
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

_MCAP, _ROSBAG, _SQLITE = b"\x89MCAP0\r\n", b"#ROSBAG", b"SQLite format 3\x00"
_SUFFIXES = {_MCAP: ".mcap", _ROSBAG: ".bag", _SQLITE: ".db3"}
_METADATA = "metadata.yaml"
_NAMED = 5  # files in a note
_CHUNK, _KEPT = 0x06, (0x03, 0x04, 0x05)  # records: a chunk; schema, channel and message
_LARGEST_RECORD = 1 << 28  # bytes
_END = struct.pack("<BQI", 0x0F, 4, 0) + struct.pack("<BQQQI", 0x02, 20, 0, 0, 0) + _MCAP  # data end and footer

Decompress = Callable[[bytes, str], bytes]
"""the data of a chunk by the name of its compression, as far as it goes"""


def suffix_of(file: Path) -> str:
    """The suffix that a bag has by its first bytes; empty for another file, and for one that cannot be read."""
    try:
        if not file.is_file():
            return ""
        with file.open("rb") as stream:
            begin = stream.read(16)
    except OSError:
        return ""
    return next((suffix for magic, suffix in _SUFFIXES.items() if begin.startswith(magic)), "")


def bag_files(folder: Path) -> list[Path]:
    """The files of a ROS 2 bag in a folder, in the order of their numbers."""
    found = [file for file in folder.iterdir() if suffix_of(file) in (".mcap", ".db3")]
    return sorted(found, key=lambda file: [int(part) if part.isdigit() else part for part in _parts(file.name)])


def _parts(name: str) -> list[str]:
    return re.split(r"(\d+)", name)


@contextmanager
def readable(path: Path, decompress: Decompress, remarks: list[str]) -> Iterator[list[Path]]:
    """Paths that a reader of bags takes; what was done about the form of the bag is added to the remarks.

    A file is named as its content is, and an MCAP file that was cut short is read up to the cut, in a temporary folder.
    """
    with tempfile.TemporaryDirectory(prefix="sixthsense-") as folder:
        into = Path(folder)
        if not path.is_dir():
            yield [_named(path, into, decompress, remarks)]
            return
        files = bag_files(path)
        is_cut = any(file.suffix == ".mcap" and not _has_end(file) for file in files)
        if (path / _METADATA).is_file() and not is_cut and _has_all(path):
            yield [path]
            return
        if files and not is_cut:
            kind = "names other files" if (path / _METADATA).is_file() else "is not there"
            some = ", ".join(file.name for file in files[:_NAMED])
            more = f" and {len(files) - _NAMED} more" * (len(files) > _NAMED)
            remarks.append(f"{_METADATA} {kind}: read {some}{more}")
        yield [_named(file, into, decompress, remarks) for file in files] or [path]


def _has_all(folder: Path) -> bool:
    """Whether the files that the metadata names are there; what they say otherwise is the reader's."""
    text = (folder / _METADATA).read_text(encoding="utf-8", errors="replace")
    listed = re.search(r"relative_file_paths:\s*\n((?:\s*-\s*.+\n)+)", text)
    names = re.findall(r"-\s*[\"']?([^\"'\n]+?)[\"']?\s*\n", listed.group(1)) if listed else []
    return all((folder / name).exists() for name in names)


def _named(file: Path, into: Path, decompress: Decompress, remarks: list[str]) -> Path:
    """The file, or one of the right name and with an end."""
    suffix = suffix_of(file)
    target = into / f"{file.stem or 'bag'}{suffix}"
    if suffix == ".mcap" and not _has_end(file):
        count = _recover(file, target, decompress)
        remarks.append(f"{file.name} is cut short: the {count} messages up to the cut are read")
        return target
    if not suffix or file.suffix == suffix:
        return file
    target.symlink_to(file.resolve())
    return target


def _has_end(file: Path) -> bool:
    with file.open("rb") as stream:
        stream.seek(0, 2)
        if stream.tell() < 2 * len(_MCAP):
            return False
        stream.seek(-len(_MCAP), 2)
        return stream.read() == _MCAP


def _recover(file: Path, target: Path, decompress: Decompress) -> int:
    """Write the whole schemas, channels and messages of an MCAP file as one without chunks; the number of messages."""
    count = 0
    with file.open("rb") as stream, target.open("wb") as out:
        out.write(stream.read(len(_MCAP)))
        for op, content in _records(stream):
            if op == 0x01:  # the header
                out.write(struct.pack("<BQ", op, len(content)) + content)
            inner = _of_chunk(content, decompress) if op == _CHUNK else [(op, content)]
            for op_inner, record in inner:
                if op_inner in _KEPT:
                    out.write(struct.pack("<BQ", op_inner, len(record)) + record)
                    count += op_inner == _KEPT[-1]
        out.write(_END)
    return count


def _records(stream: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """The records of an MCAP file; the last one may be a chunk that is cut short."""
    while len(head := stream.read(9)) == 9:
        op, size = struct.unpack("<BQ", head)
        if size > _LARGEST_RECORD:
            return
        content = stream.read(size)
        if len(content) == size or op == _CHUNK:
            yield op, content
        if len(content) < size:
            return


def _of_chunk(content: bytes, decompress: Decompress) -> Iterator[tuple[int, bytes]]:
    """The whole records of a chunk, which may be cut short."""
    if len(content) < 32:
        return
    (length,) = struct.unpack_from("<I", content, 28)
    begin = 32 + length + 8
    data = decompress(content[begin:], content[32 : 32 + length].decode("ascii", "replace"))
    at = 0
    while at + 9 <= len(data):
        op, size = struct.unpack_from("<BQ", data, at)
        if at + 9 + size > len(data):
            return
        yield op, data[at + 9 : at + 9 + size]
        at += 9 + size
