"""Graphs of poses and landmarks in the text formats of GTSAM and g2o, replayed pose by pose."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation, polar_observation
from sixthsense.core.motion import Odometry
from sixthsense.core.source import Closure, Tick
from sixthsense.logs.log import Log
from sixthsense.logs.text_lines import Record, records, shown

_STEP_NS = 1_000_000_000
_FARTHEST, _SMALLEST = 1e6, 1e-9
_LARGEST_ENTRY = 1e12
"""largest entry of a covariance or information matrix"""
_SLACK = 1e-12
"""tolerance of an eigenvalue for rounding, relative to the largest entry"""

_NUMBERS = {b"ODOMETRY": 11, b"EDGE_SE2": 11, b"LANDMARK": 7, b"EDGE_SE2_XY": 7, b"BR": 6}
"""of the tags that are read, with two ids; in those that begin with EDGE these have an information matrix"""
_SKIPPED = (b"VERTEX2", b"VERTEX_SE2", b"VERTEX_XY", b"FIX")
TAGS = (*_NUMBERS, *_SKIPPED)


def read_graph(file: str | Path) -> Log:
    """Read a graph of consecutive poses and of landmarks seen from them; plain, gzip or bzip2.

    A line is a tag and numbers; metres, radians. Edges between poses lead from pose i to j. One from the newest pose to
    a new one is the robot's way there, any other one a loop closure between poses of the file:

        ODOMETRY i j x y theta  xx xy xt yy yt tt     GTSAM: the upper triangle of the COVARIANCE, by rows
        EDGE_SE2 i j x y theta  xx xy xt yy yt tt     g2o: the upper triangle of the INFORMATION, by rows

    (x y theta) is pose j seen from pose i, and its error has the axes of j, as GTSAM and g2o define it. Landmarks:

        LANDMARK    i l x y  xx xy yy                 GTSAM: landmark l seen from pose i; COVARIANCE of x, y
        EDGE_SE2_XY i l x y  xx xy yy                 g2o: the same with INFORMATION
        BR          i l bearing range  s_b s_r        GTSAM: with two sigmas, rad and m, above 0

    Initial values of poses and landmarks (VERTEX2, VERTEX_SE2, VERTEX_XY) and FIX are skipped. Each pose is a tick, one
    second after the previous one, with the covariance of the motion and the observations; odometry begins at zero.
    Raises InputError, naming file and line, for any other tag; an edge of a pose that no way leads to; a landmark that
    is seen before its pose, or twice from one pose; an invalid number; an invalid covariance.

    In GTSAM's `victoria_park.txt` the six and three numbers are covariances, as GTSAM's load2D reads them (sigmas of
    0.01 m, 0.002 m, 0.002 rad, and of 0.63 m). As information, 0.0001 would be an error of 100 m on a step of some
    centimetres. The reduced copy of this graph in GTSAM has 100, 500, 500 and 1.581, the square roots of the
    information of these covariances. load2D converts a LANDMARK to bearing and range, with the sigma of the bearing as
    if it were 10 m away; here x and y keep the covariance of the file. Ids there number poses and landmarks in the
    order of their first appearance.
    """
    path = Path(file)
    ticks: dict[int, Tick] = {}
    seen: dict[int, dict[LandmarkId, Observation]] = {}
    others: list[tuple[Record, int, int, Odometry]] = []

    def add(pose: int, odometry: Pose, cov: Array | None = None) -> None:
        ticks[pose] = Tick(len(ticks) * _STEP_NS, odometry, observations=seen.setdefault(pose, {}), increment_cov=cov)

    for record in records(path):
        if (tag := record.fields[0]) in _SKIPPED:
            continue
        pose, other = _ids(record)
        if not ticks:
            add(pose, Pose())
        if _NUMBERS[tag] == 11:
            step = Odometry(Pose.from_array(record.numbers(record.fields[3:6], _FARTHEST)), _covariance(record, 3))
            if other in ticks or pose != next(reversed(ticks)):
                others.append((record, pose, other, step))
            else:
                add(other, ticks[pose].odometry @ step.motion, step.cov)
        elif pose not in ticks or other in seen[pose]:
            record.fail(f"found landmark {other} from pose {pose}, allowed: once from a pose with an earlier edge")
        else:
            seen[pose][other] = _observation(record)
    if len(ticks) < 2:
        raise InputError(path, "found no edge between poses", "a graph with ODOMETRY, EDGE_SE2")
    _add_closures(ticks, others)
    return Log(list(ticks.values()))


def _add_closures(ticks: dict[int, Tick], others: list[tuple[Record, int, int, Odometry]]) -> None:
    """Add the edges between poses that are not next to each other to the tick of the later one."""
    order = {pose: number for number, pose in enumerate(ticks)}
    found: dict[int, list[Closure]] = {pose: [] for pose in ticks}
    for record, before, after, step in others:
        if before not in order or after not in order or before == after:
            newest = next(reversed(ticks))
            record.fail(f"found an edge from pose {before} to {after}, allowed: from the newest pose, {newest}")
        if order[before] > order[after]:
            before, after, step = after, before, step.inverse()
        found[after].append(Closure(order[before], step.motion, step.cov))
    for pose, tick in ticks.items() if others else ():
        ticks[pose] = replace(tick, closures=tuple(found[pose]))


def _observation(record: Record) -> Observation:
    """The landmark of a line, seen from its pose."""
    if record.fields[0] != b"BR":
        return Observation(Kind.CORNER, record.numbers(record.fields[3:5], _FARTHEST), _covariance(record, 2))
    bearing, distance, *sigmas = record.numbers(record.fields[3:], _FARTHEST).tolist()
    if min(distance, *sigmas) < _SMALLEST:
        record.fail("found a range or a sigma that is not above 0, allowed: bearing range sigma sigma")
    return polar_observation(distance, bearing, (sigmas[1] ** 2, sigmas[0] ** 2))


def _ids(record: Record) -> tuple[int, int]:
    """The two ids of a line; the symbols of GTSAM have a letter in the highest of 8 bytes."""
    tag, *fields = record.fields
    if tag not in _NUMBERS:
        record.fail(f"found tag {shown(tag)}, allowed: {', '.join(known.decode() for known in TAGS)}")
    if len(fields) != _NUMBERS[tag]:
        record.fail(f"found {tag.decode()} with {len(fields)} numbers, allowed: {_NUMBERS[tag]}")
    for text in fields[:2]:
        if re.fullmatch(rb"[a-zA-Z]\d+|\d{17,20}", text):
            record.fail(f"found {shown(text)}, a symbol of GTSAM, allowed: whole numbers, of poses renumbered from 0")
    return record.whole(1, "id"), record.whole(2, "id")


def _covariance(record: Record, size: int) -> Array:
    """(size, size) covariance from the upper triangle at the end of a line.

    Its eigenvalues are positive if it is of a landmark or the inverse of an information matrix, else at least 0.
    """
    rows, columns = np.triu_indices(size)
    matrix = np.zeros((size, size))
    matrix[rows, columns] = matrix[columns, rows] = record.numbers(record.fields[-len(rows) :], _LARGEST_ENTRY)
    is_information = record.fields[0].startswith(b"EDGE")
    slack = _SLACK * max(float(np.abs(matrix).max()), _SLACK)
    if np.linalg.eigvalsh(matrix)[0] < (slack if is_information or size == 2 else -slack):
        kind = "an information matrix" if is_information else "a covariance"
        record.fail(f"found {matrix[rows, columns].tolist()}, allowed: {kind}, which is positive definite")
    inverse = np.linalg.inv(matrix) if is_information else matrix
    return np.asarray(0.5 * (inverse + inverse.T))
