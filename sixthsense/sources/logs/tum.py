"""TUM trajectories, and tables of covariances with the same stamps: a line of numbers per pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.sources.logs.errors import LogError
from sixthsense.sources.logs.text_lines import LARGEST, Record, lines

Stamps = NDArray[np.int64]

TRIANGLES = {6: 3, 21: 6}
"""numbers of the upper triangle of a covariance, and its size"""


def read_tum(file: Path) -> tuple[Stamps, Array]:
    """Stamps (N,), ns, and poses (N, 7), x y z qx qy qz qw, of a TUM trajectory; plain, gzip or bzip2.

    Lines that are empty or begin with # are skipped. Raises LogError, naming the line, for any other line than one of
    eight finite numbers, for a quaternion that is zero, and for a file without a pose.
    """
    stamps, poses, numbers = _read_table(file, (7,), "8 numbers: stamp x y z qx qy qz qw")
    zero = np.flatnonzero(~np.any(poses[:, 3:], axis=1))
    if len(zero):
        raise LogError(f"{file} line {numbers[zero[0]]}: found a quaternion that is zero, allowed: a rotation")
    return stamps, poses


def read_covariances(file: Path) -> tuple[Stamps, Array]:
    """Stamps (N,), ns, and covariances (N, 3, 3) or (N, 6, 6): a stamp and the upper triangle, row by row, in a line.

    6 numbers are of SE(2), 21 of SE(3). Raises LogError, naming the line, for any other line.
    """
    stamps, values, _ = _read_table(file, tuple(TRIANGLES), "a stamp and 6 or 21 numbers of the upper triangle")
    size = TRIANGLES[values.shape[1]]
    rows, columns = np.triu_indices(size)
    covs = np.zeros((len(stamps), size, size))
    covs[:, rows, columns] = covs[:, columns, rows] = values
    return stamps, covs


def _read_table(file: Path, widths: tuple[int, ...], allowed: str) -> tuple[Stamps, Array, list[int]]:
    """Stamps, the numbers after them, and the lines' numbers; all lines have the same width, one of `widths`."""
    fields: list[list[bytes]] = []
    numbers: list[int] = []
    stamps: list[int] = []
    for number, line in lines(file):
        words = line.replace(b",", b" ").split()
        if not words or words[0].startswith(b"#"):
            continue
        record = Record(file, number, words)
        if len(words) - 1 not in widths or (fields and len(words) != 1 + len(fields[0])):
            record.fail(f"found {len(words)} numbers, allowed: {allowed}, the same in all lines")
        stamps.append(record.stamp_ns(words[0]))
        fields.append(words[1:])
        numbers.append(number)
    if not fields:
        raise LogError(f"{file}: found no line of numbers, allowed: {allowed}")
    try:
        values = np.array(fields, dtype=np.float64)
    except ValueError:
        values = np.full((len(fields), len(fields[0])), np.nan)
    if not (np.abs(values) <= LARGEST).all():
        for number, words in zip(numbers, fields, strict=True):
            Record(file, number, words).numbers(words)  # says what is wrong in the first bad line
    return np.array(stamps, dtype=np.int64), values, numbers
