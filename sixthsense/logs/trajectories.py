"""Text files of poses, or of covariances, with stamps: TUM, EuRoC, and others whose header names their columns."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.logs.stamps import unit_of
from sixthsense.logs.text_lines import Table, read_table, words

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
    seconds, or as large as those in a part of a second since 1970, which is said in `notes`. Raises InputError, naming
    the line, for one that has other numbers, and for a quaternion of zeros.
    """
    table = read_table(file)
    width = table.numbers.shape[1]
    columns = _named(table)
    if not columns and width not in _FORMS:
        table.records[0].fail(f"found {width} fields{_HINTS.get(width, '')}, allowed: {_ALLOWED}")
    form = _PLANE if "theta" in columns else _FORMS.get(width, _SPACE)
    stamp, *places = [columns.get(name, k) for k, name in enumerate(("stamp", *form))]
    values = table.numbers[:, places]
    is_turned = values[:, 3:].any(axis=1)
    if form is _SPACE and not is_turned.all():
        table.records[int(np.argmin(is_turned))].fail("found a quaternion that is zero, allowed: a rotation")
    return _stamps_ns(table, notes, stamp), values


def read_covariances(file: Path, notes: list[str]) -> tuple[NDArray[np.int64], Array]:
    """Stamps (N,), ns, and covariances (N, 3, 3) or (N, 6, 6): in a line a stamp, and the upper triangle or all.

    By rows: 6 or 9 numbers are of SE(2), 21 or 36 of SE(3). Stamps and `notes` are as of `read_trajectory`. Raises
    InputError, naming the line, for any other.
    """
    table = read_table(file)
    values = table.numbers[:, 1:]
    if (count := values.shape[1]) not in _SIZES:
        table.records[0].fail(f"found {count + 1} fields, allowed: a stamp and 6, 9, 21 or 36 numbers of a covariance")
    size = _SIZES[count]
    rows, columns = np.indices((size, size)).reshape(2, -1) if count == size * size else np.triu_indices(size)
    covs = np.zeros((len(values), size, size))
    covs[:, columns, rows] = covs[:, rows, columns] = values
    return _stamps_ns(table, notes), covs


def _stamps_ns(table: Table, notes: list[str], column: int = 0) -> NDArray[np.int64]:
    """(N,) stamps, ns, of a column in seconds; in another unit if they say so, with a note."""
    parts, name = unit_of(table.numbers[:, column])
    if parts > 1:
        notes.append(f"{table.records[0].path}: stamps as large as {table.numbers[0, column]:.0f} are taken as {name}")
    return table.stamps_ns(column, parts)


def _named(table: Table) -> dict[str, int]:
    """The column of each part of a pose, by the last line of a header with so many names; empty where none has them.

    EuRoC names q_RS_w and p_RS_R_x what others name qw and x.
    """
    for line in reversed(table.header):
        names = words(re.sub(rb"\[[^]]*\]", b"", line).lstrip(b"# ").lower())
        short = r"^(?:(q)|p|t|pos|position)[a-z_.]*?_?([xyzw])$"
        parts = [re.sub(short, r"\1\2", name.decode("ascii", "replace")) for name in names]
        columns = {_ALIASES.get(part, part): place for place, part in reversed(list(enumerate(parts)))}
        if len(names) == table.numbers.shape[1] and any(columns.keys() >= {*form} for form in _FORMS.values()):
            return columns
    return {}
