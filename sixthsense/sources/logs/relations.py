"""Hand-checked relative poses of a log, the reference for a trajectory (Kümmerle et al. 2009)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.sources.logs.text_lines import read_table

_STAMP_SLACK_S = 1e-6


@dataclass(frozen=True, slots=True)
class Relations:
    """Relative poses of a robot at pairs of stamps, checked by hand (Kümmerle et al., Autonomous Robots 2009)."""

    stamps: Array
    """(R, 2) seconds: stamps t1 and t2 of scans in the log"""
    poses: Array
    """(R, 3) metres, radians: pose of the robot at t2 in its frame at t1"""


def read_relations(file: str | Path) -> Relations:
    """Read relations, lines of `t1 t2 dx dy dz roll pitch yaw`; blank lines and lines that begin with # are skipped.

    Seconds, metres, radians; dz, roll and pitch are ignored. Raises LogError for a file that
    cannot be read, a line that is not eight finite numbers, or a file without a relation.
    """
    table = read_table(Path(file), "t1 t2 dx dy dz roll pitch yaw").numbers
    poses = np.stack([table[:, 2], table[:, 3], wrap_angle(table[:, 7])], axis=1)
    return Relations(table[:, :2].copy(), poses)


def has_scan(stamps_s: Array, relations_stamps: Array) -> NDArray[np.bool_]:
    """(R, 2) whether a scan has the stamp of a relation to a microsecond; `stamps_s` (N,) seconds in any order."""
    ordered = np.append(np.sort(stamps_s), np.inf)
    nearest = ordered[np.searchsorted(ordered, relations_stamps - _STAMP_SLACK_S)]
    return np.asarray(nearest <= relations_stamps + _STAMP_SLACK_S)


def scan_rows(stamps_s: Array, relations_stamps: Array) -> NDArray[np.int64]:
    """(R, 2) indices of the scans of relations; `stamps_s` (N,) seconds in any order, `relations_stamps` (R, 2).

    Raises ValueError for a relation whose stamp differs from that of every scan by more than a microsecond.
    """
    order = np.argsort(stamps_s, kind="stable")
    ordered = stamps_s[order]
    place = np.searchsorted(ordered, relations_stamps - _STAMP_SLACK_S)  # (R, 2): the first stamp not before
    found = has_scan(stamps_s, relations_stamps)
    if not found.all():
        row, column = np.argwhere(~found)[0]
        raise ValueError(f"relation {row + 1} names {relations_stamps[row, column]:.6f}: no scan has that stamp")
    return order[place]
