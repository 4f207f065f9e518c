"""Text files of poses, or of covariances, with stamps: TUM, EuRoC, and others whose header names their columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.logs.text_lines import LAST_STAMP_S, Record, Table, lines, words

_SEPARATORS = b",;"
_LARGEST_STAMP = 1e9 * LAST_STAMP_S  # of any unit
_SPACE, _PLANE = ("x", "y", "z", "qx", "qy", "qz", "qw"), ("x", "y", "theta")
_FORMS = {8: _SPACE, 4: _PLANE}
"""columns behind the stamp by the number of all, where no header names them"""
_ALLOWED = "8 (stamp x y z qx qy qz qw), 4 (stamp x y theta), or a header that names the columns"
_KITTI = 12
_SIZES = {6: 3, 21: 6, 9: 3, 36: 6}
"""numbers of a covariance, its upper triangle or all, and its size"""


def read_trajectory(file: Path, notes: list[str]) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and poses, (N, 7) x y z qx qy qz qw or (N, 3) x y theta; plain or compressed.

    Columns are those that a header names, as that of EuRoC, else those of TUM files, or stamp x y theta. Stamps are
    seconds, or as large as those in a part of a second since 1970. Lines that cannot be used are left out. Both are
    said in `notes`. Raises InputError, naming the line, for a file without a pose.
    """
    header, found = _records(file)
    width = max({len(record.fields) for record in found}, key=[len(record.fields) for record in found].count, default=0)
    columns = _named(header, width)
    if columns is None and width not in _FORMS:
        hints = dict.fromkeys((14, 15, 16), ", are there decimal commas?")
        hints[_KITTI] = ", as those of KITTI, which have no stamps"
        at, seen = (f" line {found[0].line}", f"{width} fields") if found else ("", "no line of numbers")
        raise InputError(f"{file}{at}", f"found {seen}{hints.get(width, '')}", _ALLOWED)
    form = _PLANE if columns is not None and "theta" in columns else _FORMS.get(width, _SPACE)
    places = [columns[name] for name in form] if columns is not None else range(1, width)
    stamp = (columns or {}).get("stamp", 0)
    good = _usable(found, width, notes, (stamp, *places), is_space=form is _SPACE)
    return good.stamps_ns(notes), good.numbers[:, 1:]


def read_covariances(file: Path, notes: list[str]) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and covariances (N, 3, 3) or (N, 6, 6): in a line a stamp, and the upper triangle or all.

    By rows: 6 or 9 numbers are of SE(2), 21 or 36 of SE(3). Stamps, lines that cannot be used and `notes` are as of
    `read_trajectory`. Raises InputError, naming the line, for any other.
    """
    _, found = _records(file)
    width = len(found[0].fields) if found else 0
    if width - 1 not in _SIZES:
        at, seen = (f" line {found[0].line}", f"{width} fields") if found else ("", "no line of numbers")
        raise InputError(f"{file}{at}", f"found {seen}", "a stamp and 6, 9, 21 or 36 numbers of a covariance")
    table = _usable(found, width, notes, range(width))
    values, size = table.numbers[:, 1:], _SIZES[width - 1]
    if values.shape[1] == size * size:
        return table.stamps_ns(notes), values.reshape(-1, size, size)
    rows, columns = np.triu_indices(size)
    covs = np.zeros((len(values), size, size))
    covs[:, rows, columns] = covs[:, columns, rows] = values
    return table.stamps_ns(notes), covs


def _records(file: Path) -> tuple[list[bytes], list[Record]]:
    """The lines before the first one of numbers, and those from there on that are no comments."""
    header: list[bytes] = []
    found: list[Record] = []
    for number, line in lines(file):
        fields = words(line, _SEPARATORS)
        if not found and fields and not re.match(rb"[-+.0-9]|nan", fields[0]):
            header.append(line)
        elif fields and not fields[0].startswith(b"#"):
            found.append(Record(file, number, fields))
    return header, found


def _named(header: Sequence[bytes], width: int) -> dict[str, int] | None:
    """The column of each part of a pose, by the last line of a header with so many names; None where none has them."""
    for line in reversed(header):
        names = words(re.sub(rb"\[[^]]*\]", b"", line).lstrip(b"# "), _SEPARATORS)
        columns: dict[str, int] = {}
        for place, name in enumerate(names):
            part = _part(name.decode("ascii", "replace").lower())
            columns.setdefault(part, place)
        for form in (_SPACE, _PLANE):
            if len(names) == width and all(part in columns for part in form):
                return {part: columns[part] for part in ("stamp", *form) if part in columns}
    return None


def _part(name: str) -> str:
    """The part of a pose that the name of a column means: `q_RS_w` and `qw`, `p_RS_R_x` and `x`."""
    if name in ("theta", "yaw", "heading"):
        return "theta"
    if name.strip() in ("t", "time", "timestamp", "stamp", "sec", "secs", "seconds"):
        return "stamp"
    found = re.fullmatch(r"(?:(q|p|t|pos|position)[a-z_.]*?_?)?([xyzw])", name.replace(" ", ""))
    if found is None:
        return name
    return f"q{found[2]}" if found[1] == "q" else found[2]


def _usable(
    found: Sequence[Record], width: int, notes: list[str], places: Sequence[int], is_space: bool = False
) -> Table:
    """Some columns of the lines that can be used; the others are counted in a note. InputError where there is none."""
    refused: list[str] = []
    good, rows = [], []
    for record in found:
        try:
            if len(record.fields) != width:
                record.fail(f"found {len(record.fields)} fields, allowed: {width} in every line")
            stamp = record.numbers([record.fields[places[0]]], _LARGEST_STAMP)
            row = record.numbers([record.fields[k] for k in places[1:]])
            if is_space and not row[3:].any():
                record.fail("found a quaternion that is zero, allowed: a rotation")
        except InputError as error:
            refused.append(str(error.at(error.where.removeprefix(f"{record.path} "))))
            continue
        good.append(Record(record.path, record.line, [record.fields[k] for k in places]))
        rows.append([*stamp, *row])
    if not good:
        raise InputError("", f"{found[0].path} {refused[0]}")
    if refused:
        notes.append(f"{found[0].path}: {len(refused)} of {len(found)} lines left out, the first: {refused[0]}")
    return Table(good, np.array(rows))
