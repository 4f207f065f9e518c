"""Every figure that a run writes, as lines of text, and how many digits of them survive."""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

Figures = dict[str, str]
"""a line of text by its name"""

TIMES = re.compile(r"^(wall_time_s|realtime_factor|scan_ms_.*|stage_ms_.*|ms|total_ms)$")
"""keys of what a machine is fast at"""
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?~?(?![\w.])", re.IGNORECASE)
MARGIN = 5.0
"""one unit of the last digit kept is at least so many times the largest change seen"""
MOST_DIGITS = 7
"""of a number that changes at all: a range is a float32"""


def figures(run: Path) -> Figures:
    """Those of a run's folder but for times, versions and pictures."""
    found: Figures = {}
    for file in sorted(run.rglob("*")):
        read = READERS.get(file.suffix)
        if read is not None:
            found |= {f"{file.name}: {name}": line for name, line in read(file).items()}
    return {name: line.replace(str(run.parent), "") for name, line in found.items()}


def _ends(lines: Sequence[str]) -> Figures:
    return {"lines": str(len(lines)), "first": lines[0]} | ({"last": lines[-1]} if len(lines) > 1 else {})


def _text(file: Path) -> Figures:
    return _ends(file.read_text(encoding="utf-8").partition("\n[versions]")[0].splitlines())


def _json(file: Path) -> Figures:
    return {name: json.dumps(value) for name, value in _lasting(json.loads(file.read_text(encoding="utf-8"))).items()}


def _lasting(table: dict[str, Any]) -> dict[str, Any]:
    return {name: _plain(value) for name, value in table.items() if not TIMES.match(name)}


def _plain(value: Any) -> Any:
    """A value of a record, with packed numbers as their count, sum and first ones."""
    if isinstance(value, str) and len(value) > 10:
        try:
            return _summary(np.frombuffer(base64.b64decode(value, validate=True), dtype=np.float64))
        except (binascii.Error, ValueError):
            return value
    return value


def _record(file: Path) -> Figures:
    """The first and last line of each kind."""
    kinds: dict[str, list[str]] = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        table = json.loads(line)
        if "scan" in table:  # as known when the line is written, which time decides; record.npz and metrics have them
            del table["since_key"], table["path_length_m"]
        kinds.setdefault(next(iter(table)), []).append(json.dumps(_lasting(table)))
    return {f"{kind}, {name}": line for kind, lines in kinds.items() for name, line in _ends(lines).items()}


def _yaml(file: Path) -> Figures:
    if file.name == "metadata.yaml":
        table = yaml.safe_load(file.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        return {name: str(table[name]) for name in ("duration", "starting_time", "message_count")}
    return {str(k): line for k, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1)}


def _arrays(file: Path) -> Figures:
    with np.load(file) as arrays:
        return {name: _summary(arrays[name]) for name in sorted(arrays) if not TIMES.match(name)}


def _summary(array: Any) -> str:
    """Shape, first numbers and sum; how far along each axis its numbers lie tells it from its mirror image."""
    if array.dtype.kind == "U":
        return json.dumps(array.tolist())
    values = np.nan_to_num(np.asarray(array, dtype=np.float64))
    along = [float((np.abs(values) * place).sum()) for place in np.indices(values.shape, sparse=True)]
    return f"shape {list(values.shape)} first {values.ravel()[:6].tolist()} sum {float(values.sum())} along {along}"


def _picture(file: Path) -> Figures:
    kind, width, height, most, pixels = re.split(rb"\s", file.read_bytes(), maxsplit=4)
    cells = np.frombuffer(pixels, dtype=np.uint8).reshape(int(height), int(width))
    shades = {int(shade): _summary(cells == shade) for shade in np.unique(cells)}
    return {"header": f"{kind.decode()} {int(most)}"} | {f"shade {shade}": line for shade, line in shades.items()}


def _bag(file: Path) -> Figures:
    """The first and last message of each topic."""
    store, topics = get_typestore(Stores.ROS2_HUMBLE), {}
    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            line = f"{message.log_time} {_message(store.deserialize_cdr(message.data, schema.name))}"
            topics.setdefault(channel.topic, []).append(line)
    return {f"{topic}, {name}": line for topic, lines in sorted(topics.items()) for name, line in _ends(lines).items()}


def _message(value: Any) -> str:
    """The numbers and names of a message, in their order."""
    if isinstance(value, np.ndarray):
        return _summary(value)
    if isinstance(value, list):
        return f"{len(value)} of ({') ... ('.join(map(_message, value[:1] + value[1:][-1:]))})"
    if not hasattr(value, "__dataclass_fields__"):
        return str(value)
    return " ".join(_message(getattr(value, name)) for name in value.__dataclass_fields__ if name != "__msgtype__")


READERS = {
    ".json": _json, ".jsonl": _record, ".toml": _text, ".tum": _text, ".csv": _text, ".g2o": _text, ".yaml": _yaml,
    ".npz": _arrays, ".pgm": _picture, ".mcap": _bag,
}  # fmt: skip


def surviving(line: str, others: Sequence[str]) -> str:
    """A line with the digits of its numbers that lines of the same run with other last digits of ranges share.

    A number that is cut ends with ~: it is known to one unit of its last digit. ValueError if the words differ.
    """
    alike = [NUMBER.findall(other) for other in others if NUMBER.sub("#", other) == NUMBER.sub("#", line)]
    if len(alike) < len(others):
        raise ValueError(f"found {line} and {others}, allowed: the same words")
    numbers = iter(zip(NUMBER.findall(line), *alike, strict=True))
    return NUMBER.sub(lambda _: _cut(*next(numbers)), line)


def _cut(text: str, *others: str) -> str:
    value, change = float(text), max(abs(float(other) - float(text)) for other in others)
    if change == 0.0:
        return text
    place = math.ceil(math.log10(MARGIN * change))
    if value:
        place = max(place, math.floor(math.log10(abs(value))) + 1 - MOST_DIGITS)
    return f"{Decimal(text).quantize(Decimal(1).scaleb(place))}~"


def moved(old: Figures, new: Figures) -> list[str]:
    """What is no longer as it was, a line each."""
    names = [name for name in dict.fromkeys([*old, *new]) if not _agree(old.get(name), new.get(name))]
    return [f"{name}\n    old {old.get(name, 'none')}\n    new {new.get(name, 'none')}" for name in names]


def _agree(old: str | None, new: str | None) -> bool:
    if old is None or new is None or NUMBER.sub("#", old) != NUMBER.sub("#", new):
        return False
    return all(map(_is_near, NUMBER.findall(old), NUMBER.findall(new)))


def _is_near(old: str, new: str) -> bool:
    if not old.endswith("~"):
        return math.isclose(float(old), float(new.rstrip("~")), rel_tol=1e-9, abs_tol=1e-12)
    known = Decimal(old[:-1])
    return abs(Decimal(new.rstrip("~")) - known) <= Decimal(1).scaleb(int(known.as_tuple().exponent))


def read(file: Path) -> Figures:
    """Those that a file keeps, a name and its line each; none if there is no file."""
    if not file.exists():
        return {}
    return dict(line.split(" = ", 1) for line in file.read_text(encoding="utf-8").splitlines())


def write(file: Path, kept: Figures) -> None:
    """Keep figures in a file."""
    file.write_text("".join(f"{name} = {line}\n" for name, line in kept.items()), encoding="utf-8")
