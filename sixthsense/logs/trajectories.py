"""Text files of poses, or of covariances, with stamps: TUM, EuRoC, and others whose header names their columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.logs.text_lines import LAST_STAMP_S, Record, Table, lines, numbers_of, words

_SEPARATORS = b",;"
_SPACE, _PLANE = ("x", "y", "z", "qx", "qy", "qz", "qw"), ("x", "y", "theta")
_FORMS = {8: _SPACE, 4: _PLANE}
"""columns behind the stamp by the number of all, where no header names them"""
_ALLOWED = "8 (stamp x y z qx qy qz qw), 4 (stamp x y theta), or a header that names the columns"
_HINTS = {12: ", as those of KITTI, which have no stamps", 16: ", are there decimal commas?"}
_ALIASES = {"yaw": "theta", "heading": "theta", **dict.fromkeys(("t", "time", "timestamp", "sec"), "stamp")}
_SIZES = {6: 3, 21: 6, 9: 3, 36: 6}
"""numbers of a covariance, its upper triangle or all, and its size"""


def read_trajectory(file: Path, notes: list[str]) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and poses, (N, 7) x y z qx qy qz qw or (N, 3) x y theta; plain or compressed.

    Columns are those that a header names, as that of EuRoC, else those of TUM files, or stamp x y theta. Stamps are
    seconds, or as large as those in a part of a second since 1970. Lines that cannot be used are left out. Both are
    said in `notes`. Raises InputError, naming the line, for a file without a pose.
    """
    header, table = _read(file, notes)
    width = table.numbers.shape[1]
    columns = _named(header, width)
    if not columns and width not in _FORMS:
        at = f"{file} line {table.records[0].line}"
        raise InputError(at, f"found {width} fields{_HINTS.get(width, '')}", _ALLOWED)
    form = _PLANE if "theta" in columns else _FORMS.get(width, _SPACE)
    stamp, *places = [columns.get(name, k) for k, name in enumerate(("stamp", *form))]
    values = table.numbers[:, places]
    good = np.asarray(values[:, 3:].any(axis=1)) | (form is _PLANE)  # a rotation is no quaternion of zero
    if not good.all():
        notes.append(f"{file}: {np.count_nonzero(~good)} lines with a quaternion that is zero are left out")
        table = Table(
            [record for record, is_good in zip(table.records, good, strict=True) if is_good], table.numbers[good]
        )
    if not good.any():
        raise InputError(f"{file}", "found quaternions that are zero in all lines", "rotations")
    return table.stamps_ns(notes, stamp), values[good]


def read_covariances(file: Path, notes: list[str]) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and covariances (N, 3, 3) or (N, 6, 6): in a line a stamp, and the upper triangle or all.

    By rows: 6 or 9 numbers are of SE(2), 21 or 36 of SE(3). Stamps, lines that cannot be used and `notes` are as of
    `read_trajectory`. Raises InputError, naming the line, for any other.
    """
    _, table = _read(file, notes)
    values = table.numbers[:, 1:]
    if (count := values.shape[1]) not in _SIZES:
        at = f"{file} line {table.records[0].line}"
        raise InputError(at, f"found {count + 1} fields", "a stamp and 6, 9, 21 or 36 numbers of a covariance")
    size = _SIZES[count]
    if count == size * size:
        return table.stamps_ns(notes), values.reshape(-1, size, size)
    rows, columns = np.triu_indices(size)
    covs = np.zeros((len(values), size, size))
    covs[:, rows, columns] = covs[:, columns, rows] = values
    return table.stamps_ns(notes), covs


def _read(file: Path, notes: list[str]) -> tuple[list[bytes], Table]:
    """The lines before the first one of numbers, and the numbers of those after it that have as many as most.

    Others are counted in a note. Raises InputError for a file without a line of numbers.
    """
    header: list[bytes] = []
    found: list[Record] = []
    for number, line in lines(file):
        fields = words(line, _SEPARATORS)
        if not found and fields and not re.match(rb"[-+.0-9]|nan", fields[0]):
            header.append(line)
        elif fields and not fields[0].startswith(b"#"):
            found.append(Record(file, number, fields))
    widths = [len(record.fields) for record in found]
    refused, good, rows = [], [], []
    for record in found:
        try:
            rows.append(numbers_of(record, max(widths, key=widths.count), largest=1e9 * LAST_STAMP_S))
            good.append(record)
        except InputError as error:
            refused.append(str(error.at(error.where.removeprefix(f"{file} "))))
    if not good:
        raise InputError("", f"{file} {refused[0]}" if refused else f"{file}: found no line of numbers")
    if refused:
        notes.append(f"{file}: {len(refused)} of {len(found)} lines left out, the first: {refused[0]}")
    return header, Table(good, np.array(rows))


def _named(header: Sequence[bytes], width: int) -> dict[str, int]:
    """The column of each part of a pose, by the last line of a header with so many names; empty where none has them.

    EuRoC names q_RS_w and p_RS_R_x what others name qw and x.
    """
    for line in reversed(header):
        text = re.sub(rb"\[[^]]*\]", b"", line)
        names = [name.decode("ascii", "replace") for name in words(text.lstrip(b"# ").lower(), _SEPARATORS)]
        parts = [re.sub(r"^(?:(q)|p|t|pos|position)[a-z_.]*?_?([xyzw])$", r"\1\2", name) for name in names]
        columns = {_ALIASES.get(part, part): place for place, part in reversed(list(enumerate(parts)))}
        if len(names) == width and any(columns.keys() >= set(form) for form in (_SPACE, _PLANE)):
            return columns
    return {}
