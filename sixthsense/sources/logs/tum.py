"""TUM trajectories, and tables of covariances with the same stamps: a line of numbers per pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.sources.logs.text_lines import read_table

Stamps = NDArray[np.int64]

TRIANGLES = {6: 3, 21: 6}
"""numbers of the upper triangle of a covariance, and its size"""


def read_tum(file: Path) -> tuple[Stamps, Array]:
    """Stamps (N,), ns, and poses (N, 7), x y z qx qy qz qw, of a TUM trajectory; plain, gzip or bzip2.

    Lines that are empty or begin with # are skipped. Raises LogError, naming the line, for any other line than one of
    eight finite numbers, for a quaternion that is zero, and for a file without a pose.
    """
    table = read_table(file, "stamp x y z qx qy qz qw")
    zero = np.flatnonzero(~np.any(table.numbers[:, 4:], axis=1))
    if len(zero):
        table.records[zero[0]].fail("found a quaternion that is zero, allowed: a rotation")
    return np.array(table.stamps_ns(), dtype=np.int64), table.numbers[:, 1:]


def read_covariances(file: Path) -> tuple[Stamps, Array]:
    """Stamps (N,), ns, and covariances (N, 3, 3) or (N, 6, 6): a stamp and the upper triangle, row by row, in a line.

    6 numbers are of SE(2), 21 of SE(3). Raises LogError, naming the line, for any other line.
    """
    table = read_table(file, "a stamp and the upper triangle", [1 + count for count in TRIANGLES])
    values = table.numbers[:, 1:]
    size = TRIANGLES[values.shape[1]]
    rows, columns = np.triu_indices(size)
    covs = np.zeros((len(values), size, size))
    covs[:, rows, columns] = covs[:, columns, rows] = values
    return np.array(table.stamps_ns(), dtype=np.int64), covs
