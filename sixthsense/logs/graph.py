"""Graphs of poses and landmarks in the text formats of GTSAM and g2o, replayed pose by pose."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

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

_MOTIONS, _POINTS = (b"ODOMETRY", b"EDGE_SE2"), (b"LANDMARK", b"EDGE_SE2_XY")
_POLAR = b"BR"
_INFORMATION = (b"EDGE_SE2", b"EDGE_SE2_XY")
"""tags whose numbers are an information matrix; those of others are a covariance"""
_SKIPPED = (b"VERTEX2", b"VERTEX_SE2", b"VERTEX_XY", b"FIX")
TAGS = (*_MOTIONS, *_POINTS, _POLAR, *_SKIPPED)


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
    graph = _Graph()
    for record in records(path):
        tag = record.fields[0]
        if tag in _MOTIONS:
            _read_motion(graph, record)
        elif tag in (*_POINTS, _POLAR):
            _read_landmark(graph, record)
        elif tag not in _SKIPPED:
            record.fail(f"found tag {shown(tag)}, allowed: {', '.join(known.decode() for known in TAGS)}")
    if len(graph.ticks) < 2:
        raise InputError(path, "found no edge between poses", f"a graph with {b', '.join(_MOTIONS).decode()}")
    _add_closures(graph)
    return Log(list(graph.ticks.values()))


class _Edge(NamedTuple):
    """An edge between two poses."""

    record: Record
    before: int
    after: int
    step: Pose
    """pose `after` seen from `before`"""
    cov: Array
    """(3, 3) of its error, axes of `after`"""


@dataclass(slots=True)
class _Graph:
    """The part of the graph read so far."""

    ticks: dict[int, Tick] = field(default_factory=dict)
    """of the poses, by id, in order"""
    seen: dict[int, dict[LandmarkId, Observation]] = field(default_factory=dict)
    """by pose, as in its tick"""
    others: list[_Edge] = field(default_factory=list)
    """edges that do not lead from the newest pose to a new one"""

    def add(self, pose: int, odometry: Pose, cov: Array | None = None) -> None:
        """Add a pose without observations."""
        seen = self.seen[pose] = {}
        self.ticks[pose] = Tick(len(self.ticks) * _STEP_NS, odometry, observations=seen, increment_cov=cov)


def _read_motion(graph: _Graph, record: Record) -> None:
    before, after = _ids(record, 11)
    step = Pose.from_array(record.numbers(record.fields[3:6], _FARTHEST))
    cov = _covariance(record, 3, definite=False)
    if not graph.ticks:
        graph.add(before, Pose())
    if after in graph.ticks or before != next(reversed(graph.ticks)):
        graph.others.append(_Edge(record, before, after, step, cov))
    else:
        graph.add(after, graph.ticks[before].odometry @ step, cov)


def _add_closures(graph: _Graph) -> None:
    """Add the edges between poses that are not next to each other to the tick of the later one."""
    order = {pose: number for number, pose in enumerate(graph.ticks)}
    found: dict[int, list[Closure]] = {}
    for record, before, after, step, cov in graph.others:
        if before not in order or after not in order or before == after:
            newest = next(reversed(graph.ticks))
            record.fail(f"found an edge from pose {before} to {after}, allowed: from the newest pose, {newest}")
        if order[before] < order[after]:
            found.setdefault(after, []).append(Closure(order[before], step, cov))
        else:
            back = Odometry(step, cov).inverse()
            found.setdefault(before, []).append(Closure(order[after], back.motion, back.cov))
    for pose, tick in graph.ticks.items() if found else ():
        graph.ticks[pose] = replace(tick, closures=tuple(found.get(pose, ())))


def _read_landmark(graph: _Graph, record: Record) -> None:
    is_polar = record.fields[0] == _POLAR
    pose, landmark = _ids(record, 6 if is_polar else 7)
    if not graph.ticks:
        graph.add(pose, Pose())
    if pose not in graph.ticks:
        record.fail(f"found landmark {landmark} seen from pose {pose}, allowed: from a pose with an earlier edge")
    if landmark in graph.seen[pose]:
        record.fail(f"found landmark {landmark} again from pose {pose}, allowed: once from each pose")
    if not is_polar:
        place, cov = record.numbers(record.fields[3:5], _FARTHEST), _covariance(record, 2, definite=True)
        graph.seen[pose][landmark] = Observation(Kind.CORNER, place, cov)
        return
    bearing, distance, *sigmas = record.numbers(record.fields[3:], _FARTHEST).tolist()
    if min(distance, *sigmas) < _SMALLEST:
        record.fail("found a range or a sigma that is not above 0, allowed: bearing range sigma sigma")
    graph.seen[pose][landmark] = polar_observation(distance, bearing, (sigmas[1] ** 2, sigmas[0] ** 2))


def _ids(record: Record, count: int) -> tuple[int, int]:
    """The first two of so many numbers: ids; the symbols of GTSAM have a letter in the highest of 8 bytes."""
    if len(record.fields) != count + 1:
        tag = record.fields[0].decode()
        record.fail(f"found {tag} with {len(record.fields) - 1} numbers, allowed: {count}")
    for text in record.fields[1:3]:
        if re.fullmatch(rb"[a-zA-Z]\d+", text) or (text.isdigit() and len(text) <= 20 and int(text) >> 56):
            record.fail(
                f"found {shown(text)}, a symbol of GTSAM, allowed: whole numbers, as of poses renumbered from 0"
            )
    return record.whole(1, "id"), record.whole(2, "id")


def _covariance(record: Record, size: int, definite: bool) -> Array:
    """(size, size) covariance from the upper triangle at the end of a line.

    All its eigenvalues are positive if `definite`, as those of an information matrix must be.
    """
    rows, columns = np.triu_indices(size)
    values = record.numbers(record.fields[-len(rows) :])
    matrix = np.zeros((size, size))
    matrix[rows, columns] = matrix[columns, rows] = values
    is_information = record.fields[0] in _INFORMATION
    definite = definite or is_information
    largest = float(np.abs(matrix).max())
    fits = 1.0 / _LARGEST_ENTRY <= largest <= _LARGEST_ENTRY if definite else largest <= _LARGEST_ENTRY
    if not fits or np.linalg.eigvalsh(matrix)[0] < (_SLACK if definite else -_SLACK) * largest:
        kind = "an information matrix" if is_information else "a covariance"
        bounds = f"eigenvalues {'above' if definite else 'at least'} 0, entries up to {_LARGEST_ENTRY:g}"
        record.fail(f"found {values.tolist()}, allowed: {kind} with {bounds}")
    inverse = np.linalg.inv(matrix) if is_information else matrix
    return np.asarray(0.5 * (inverse + inverse.T))
