"""Every figure that a run writes, as lines of text, and how many digits of them survive."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.logs.runfolder import read_messages

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
    """The values without times, those of a table in it too."""
    return {
        name: _lasting(value) if isinstance(value, dict) else value
        for name, value in table.items()
        if not TIMES.match(name)
    }


def _record(file: Path) -> Figures:
    """First and last value of each channel of JSON, and each column of the arrays."""
    channels: dict[str, list[Any]] = {}
    for channel, stamp_ns, value in read_messages(file)[0]:
        channels.setdefault(channel, []).append((stamp_ns, value))
    found = {}
    for channel, messages in channels.items():
        stamps, values = zip(*messages, strict=True)
        found[f"{channel}, stamps"] = f"{len(stamps)} from {stamps[0]} to {stamps[-1]}"
        if isinstance(values[0], dict):
            found |= {f"{channel}, {key}": json.dumps(value) for key, value in _lasting(values[-1]).items()}
            continue
        rows = np.concatenate(values)
        names = [name for name in rows.dtype.names or [""] if not TIMES.match(name)]
        found |= {f"{channel}, {name}": _summary(rows[name] if name else rows) for name in names}
    return found


def _yaml(file: Path) -> Figures:
    return {str(k): line for k, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1)}


def _summary(array: Any) -> str:
    """Shape, first numbers and sum; how far along each axis its numbers lie tells it from its mirror image."""
    values = np.nan_to_num(np.asarray(array, dtype=np.float64))
    along = [float((np.abs(values) * place).sum()) for place in np.indices(values.shape, sparse=True)]
    return f"shape {list(values.shape)} first {values.ravel()[:6].tolist()} sum {float(values.sum())} along {along}"


def _picture(file: Path) -> Figures:
    kind, width, height, most, pixels = re.split(rb"\s", file.read_bytes(), maxsplit=4)
    cells = np.frombuffer(pixels, dtype=np.uint8).reshape(int(height), int(width))
    shades = {int(shade): _summary(cells == shade) for shade in np.unique(cells)}
    return {"header": f"{kind.decode()} {int(most)}"} | {f"shade {shade}": line for shade, line in shades.items()}


READERS = {
    ".json": _json, ".mcap": _record, ".toml": _text, ".tum": _text, ".csv": _text, ".yaml": _yaml, ".pgm": _picture,
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
