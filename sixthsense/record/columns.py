"""The columns of a run's record: one table from which it is written, read and checked.

A field of the trace has one column, or several if its values have parts. `record.jsonl` has the tables `RUN`, `SCAN`,
`KEYFRAME` and `PLAN`, a line for each row; `record.npz` has `END`, an array for each column.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import as_table
from sixthsense.config.section import shown
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.core.sensor import SENSOR_PARAMETERS
from sixthsense.core.wheels import PARAMETERS
from sixthsense.logs.log import Relations
from sixthsense.navigation.unseen_places import UnseenPlace, as_reason
from sixthsense.record.trace import STAGES
from sixthsense.simulation.scene import Scene
from sixthsense.simulation.walking_space import ScriptedWalk
from sixthsense.slam.association.records import Association, MeanShape, Record
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.front_end import LoopClosureCounts, PoseLinks
from sixthsense.slam.mapping.grid import Grid

FORMAT = 2
POSE, SQUARES = "m, m, rad", "m², m rad, rad²"
_TYPES: dict[type, tuple[str, Any]] = {float: ("f", "<f8"), int: ("iu", "<i8"), bool: ("b", "?"), str: ("U", "U")}
"""kinds of arrays that hold a type, and the one of a list that is written"""

Sizes = dict[str, int]
"""lengths by their letters"""


@dataclass(frozen=True, slots=True)
class Column:
    """One array of a record, or in a line one value."""

    name: str
    shape: tuple[int | str, ...] = ()
    """lengths; a letter is a length that the columns of a file have in common, "" any"""
    unit: str = ""
    type: type = float
    least: int | None = None
    """of whole numbers"""
    may_lack: bool = False
    """whether a number may be NaN, which is null in a line"""

    @property
    def is_packed(self) -> bool:
        """Whether a line has the numbers in base64: a long list of them takes a fraction of the time to write."""
        return self.type is float and "" in self.shape

    def array(self, value: Any) -> NDArray[Any]:
        """What is written of a value."""
        given = np.asarray(value, dtype=None if isinstance(value, np.ndarray) else _TYPES[self.type][1])
        return given.reshape(0, *self.shape[1:]) if given.size == 0 and given.ndim < len(self.shape) else given

    def to_line(self, value: Any) -> Any:
        """A value as JSON has it. Every float64 is kept to the last bit."""
        if self.is_packed:
            return base64.b64encode(np.asarray(value, dtype="<f8").tobytes()).decode("ascii")
        plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        if not self.may_lack:
            return plain
        return [_or_none(number) for number in plain] if self.shape else _or_none(plain)

    def from_line(self, line: Mapping[str, Any]) -> Any:
        """The value of this column in a line; ValueError if it is not of its type and shape."""
        value = line[self.name]
        try:
            if self.is_packed:
                lengths = [-1 if length == "" else length for length in self.shape]
                array = np.frombuffer(base64.b64decode(value, validate=True), dtype="<f8").reshape(lengths)  # type: ignore[arg-type]
            else:
                array = np.array(value, dtype=np.float64 if self.type is float else None)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"{self.name} {shown(value)}") from None
        return self.checked(array, {})

    def checked(self, array: NDArray[Any], sizes: Sizes) -> Any:
        """The array, or its only value; ValueError if it is not of this type and shape. New lengths join `sizes`."""
        kinds, _ = _TYPES[self.type]
        found = f"{self.name} of shape {array.shape} and type {array.dtype}"
        if array.dtype.kind not in kinds or array.ndim != len(self.shape):
            raise ValueError(found)
        for length, expected in zip(array.shape, self.shape, strict=True):
            known = sizes.setdefault(expected, length) if isinstance(expected, str) and expected else expected
            if known not in ("", length):
                raise ValueError(found)
        if self.type is float and not (self.may_lack or np.isfinite(array).all()):
            raise ValueError(f"{found} with a number that is not finite")
        if self.least is not None and array.size and array.min() < self.least:
            raise ValueError(f"{self.name} {shown(int(array.min()))}")
        if not self.shape:
            return array.item()
        return np.array(array, dtype=None if self.type is str else self.type)


def _or_none(number: float) -> float | None:
    return None if math.isnan(number) else number


@dataclass(frozen=True, slots=True)
class Field:
    """A field of the trace and the columns that its value is kept in."""

    path: str
    """name in the trace, with a dot for a field of a field"""
    columns: tuple[Column, ...]
    split: Callable[[Any], Iterable[Any]]
    """what is kept of a value, in the order of the columns"""
    join: Callable[..., Any]
    """the value that is kept so"""
    is_optional: bool = False
    """whether the columns are missing where the value is None or the list is empty"""
    is_row: bool = True
    """whether the field is a list with a value for each line; otherwise it has the last line's"""

    def of(self, owner: Any) -> Any:
        """The value in a trace."""
        return getattr(owner, self.path) if "." not in self.path else attrgetter(self.path)(owner)

    def put(self, owner: Any, value: Any) -> None:
        """Set the value in a trace."""
        path, _, name = self.path.rpartition(".")
        setattr(attrgetter(path)(owner) if path else owner, name, value)

    def is_absent(self, value: Any) -> bool:
        """Whether there is nothing to write."""
        return self.is_optional and (value is None or (isinstance(value, list) and not value))


def one(path: str, *shape: int | str, name: str = "", optional: bool = False, row: bool = True, **more: Any) -> Field:
    """A field that is a column itself, of its own name or another; `more` are the other fields of `Column`."""
    column = Column(name or path, shape, **more)
    return Field(path, (column,), lambda value: (value,), lambda value: value, optional, row)


def _pose(path: str, unit: str = POSE, **more: Any) -> Field:
    return Field(path, (Column(path, (3,), unit),), lambda pose: (pose.array(),), Pose.from_array, **more)


def _estimate(path: str, pose: str, cov: str) -> Field:
    columns = Column(pose, (3,), POSE), Column(cov, (3, 3), SQUARES)
    return Field(
        path, columns, lambda e: (e.pose.array(), e.pose_cov), lambda p, c: Estimate.of_pose(Pose.from_array(p), c)
    )


def _times(path: str, name: str, row: bool) -> Field:
    """Milliseconds per stage, NaN of one that was not timed."""
    return Field(
        path,
        (Column(name, (len(STAGES),), "ms", may_lack=True),),
        lambda times: ([times.get(stage, np.nan) for stage in STAGES],),
        lambda row: {stage: ms for stage, ms in zip(STAGES, row.tolist(), strict=True) if ms == ms},
        is_row=row,
    )


def _observation_row(observation: Observation, landmark: LandmarkId) -> list[float]:
    s = observation
    return [landmark, int(s.kind), *s.z.tolist(), *s.cov.ravel().tolist(), *s.extent]


def _split_association(found: Association) -> Iterable[Any]:
    yield [_observation_row(observation, i) for i, observation in found.observations.items()]
    yield from (int(found.discarded), float(found.nis), int(found.dof), int(found.fused))


def _join_association(rows: NDArray[Any], *counts: Any) -> Association:
    observations = {}
    for landmark, kind, x, y, c00, c01, c10, c11, first, last in rows.tolist():
        if not landmark.is_integer():
            raise ValueError(f"an observation of landmark {landmark}")
        cov = np.array([[c00, c01], [c10, c11]])
        observations[int(landmark)] = Observation(Kind(int(kind)), np.array([x, y]), cov, (first, last))
    return Association(observations, *counts)


def _split_final(estimate: Estimate) -> Iterable[Any]:
    yield np.concatenate([estimate.pose.array(), estimate.landmarks.ravel()])
    yield from (estimate.ids, estimate.walls)


def _join_final(mean: NDArray[Any], ids: NDArray[Any], walls: NDArray[Any]) -> Estimate:
    """The final estimate; its covariance is a field of the trace of its own."""
    if len(mean) != 3 + 2 * len(ids):
        raise ValueError(f"mean of shape {mean.shape} with {len(ids)} landmarks")
    return Estimate(Pose.from_array(mean[:3]), np.zeros((3, 3)), ids, mean[3:].reshape(-1, 2), walls)


_COUNTS = ("kind", "observations", "first_scan", "last_scan")


def _split_records(records: Mapping[LandmarkId, Record]) -> Iterable[Any]:
    rows = list(records.values())
    yield list(records)
    yield from ([getattr(row, name) for row in rows] for name in _COUNTS)
    yield [row.sigma_m for row in rows]
    yield [row.extent for row in rows]
    yield [(row.shape.observations, *row.shape.information, *row.shape.weighted) for row in rows]


def _join_records(ids: NDArray[Any], *columns: NDArray[Any]) -> dict[LandmarkId, Record]:
    found = {}
    for i, row in zip(ids.tolist(), zip(*columns, strict=True), strict=True):
        kind, observations, first, last, sigma_m, extent, (count, a, b, c, d) = row
        shape = MeanShape(int(count), (float(a), float(b)), (float(c), float(d)))
        found[i] = Record(Kind(kind), int(observations), int(first), int(last), float(sigma_m), extent, shape)
    return found


def _split_grid(grid: Grid) -> Iterable[Any]:
    """One array at a time: a large map would be the most memory of a run."""
    yield grid.narrow("hits")
    yield grid.narrow("passes")
    yield grid.seen
    yield np.array(grid.origin)


def _join_left(places: NDArray[Any], reasons: NDArray[Any], gaps_m: NDArray[Any]) -> list[UnseenPlace]:
    return [
        UnseenPlace(x, y, area_m2, as_reason(reason), gap_m if gap_m == gap_m else None)
        for (x, y, area_m2), reason, gap_m in zip(places.tolist(), reasons.tolist(), gaps_m.tolist(), strict=True)
    ]


def _split_left(left: list[UnseenPlace]) -> Iterable[Any]:
    yield [(place.x, place.y, place.area_m2) for place in left]
    yield [place.reason for place in left]
    yield [np.nan if place.gap_m is None else place.gap_m for place in left]


SCENE = (
    one("name", type=str),
    one("walls", "", 2, 2, unit="m"),
    _pose("start", is_optional=True),
    one("radius", unit="m"),
    Field("goal", (Column("goal", (2,), "m"),), lambda xy: (xy,), lambda xy: tuple(xy.tolist()), is_optional=True),
    Field("tour", (Column("tour", ("", 2), "m"),), lambda tour: (tour,), lambda rows: tuple(map(tuple, rows.tolist()))),
    Field("region", (Column("region", (4,), "m"),), lambda region: (region,), lambda row: tuple(row.tolist())),
    one("solid_left", type=bool),
    one("glass", "", 2, 2, unit="m"),
)
"""the scene of a run, which outlives its file; walks of people stand beside it as they do in a scene's file"""

SCAN = (
    one("stamps_ns", name="scan", unit="ns", type=int, least=0),
    one("log_stamps_s", unit="s", may_lack=True),
    one("estimates", 3, unit=POSE),
    one("odometry", 3, unit=POSE),
    one("truths", 3, unit=POSE, optional=True),
    one("walkers", "", 3, unit=POSE, optional=True),
    Field("touches", (Column("touches", (2,), type=int, least=0),), lambda pair: (pair,),
         lambda pair: tuple(pair.tolist()), is_optional=True, is_row=False),
    one("last_key", type=int, least=-1),
    one("since_key", 3, unit=POSE),
    one("since_covs", 3, 3, name="since_cov", unit=SQUARES, optional=True),
    one("path_length_m", unit="m", row=False),
)  # fmt: skip
"""per scan: fields of the same names in `Trace`"""

KEYFRAME = (
    one("key_stamps_ns", name="keyframe", unit="ns", type=int, least=0),
    Field("key_odometry", (Column("motion", (3,), POSE), Column("motion_cov", (3, 3), SQUARES)),
         lambda m: (m.motion.array(), m.cov), lambda motion, cov: Odometry(Pose.from_array(motion), cov)),
    _estimate("key_predicted", "predicted_pose", "predicted_cov"),
    _estimate("key_estimates", "pose", "pose_cov"),
    one("key_truths", 3, name="truth", unit=POSE, optional=True),
    Field("associations", (Column("observations", ("", 10)), Column("discarded", type=int, least=0), Column("nis"),
                          Column("dof", type=int, least=0), Column("fused", type=int, least=0)),
         _split_association, _join_association),
    one("walls_found", "", 2, 2, name="walls", unit="m"),
    _times("stopwatch.rows", "ms", row=True),
    _times("stopwatch.totals", "total_ms", row=False),
)  # fmt: skip
"""per keyframe; a row of `observations` is a landmark's id and kind, what is seen (2), covariance (4) and extent (2)"""

PLAN = (one("plans", "", 2, name="plan", unit="m"),)
"""per planned path"""

FINAL = (
    Field("final", (Column("mean", ("d",), "m, rad"), Column("ids", ("n",), type=int),
                   Column("walls", ("n",), type=bool)), _split_final, _join_final),
    one("joint_cov", "d", "d", name="covariance", unit="m², rad²"),
    Field("records", (Column("record_ids", ("N",), type=int), Column("record_kinds", ("N",), type=int),
                     Column("observations", ("N",), type=int), Column("first_scans", ("N",), type=int),
                     Column("last_scans", ("N",), type=int), Column("sigmas_m", ("N",), "m", may_lack=True),
                     Column("extents", ("N", 2, 2), "m"), Column("shapes", ("N", 5), "1/m², 1/m")),
         _split_records, _join_records),
)  # fmt: skip
"""the landmarks at the end: means and joint covariance, pose first, and what is known of each"""

GRID = Field(
    "grid",
    (Column("hits", ("h", "w"), type=int), Column("passes", ("h", "w"), type=int),
     Column("seen", ("h", "w"), type=bool), Column("origin", (2,), "m")),
    _split_grid, lambda *arrays: arrays, is_optional=True,
)  # fmt: skip
"""evidence of all cells, and where they are; the reader makes the grid of it"""

END = (
    one("outcome", type=str),
    one("path_length_m", unit="m"),
    one("wall_time_s", unit="s"),
    one("last_position", 2, unit="m", optional=True),
    _times("stopwatch.totals", "total_ms", row=False),
    one("culled", type=int, least=0),
    one("walls_merged", type=int, least=0),
    *(one(name, type=int, least=0, optional=True) for name in ("plans_below_margin", "plans_by_astar", "guard_stops")),
    Field("loop_closures", (Column("loop_closures", (3,), type=int, least=0),), lambda counts: (tuple(counts),),
         lambda counts: LoopClosureCounts(*counts.tolist()), is_optional=True),
    one("wheels", 2, PARAMETERS, optional=True),
    one("sensor", 2, SENSOR_PARAMETERS, optional=True),
    Field("left", (Column("left", ("p", 3), "m, m, m²"), Column("left_reasons", ("p",), type=str),
                  Column("left_gaps_m", ("p",), "m", may_lack=True)), _split_left, _join_left),
    one("trajectory", "K", 3, unit=POSE),
    Field("since_key", (Column("since_key", ("S", 3), POSE),), lambda rows: (rows,), list),
    Field("links", (Column("link_ends", ("l", 2), type=int, least=0), Column("link_motions", ("l", 3), POSE),
                   Column("link_covs", ("l", 3, 3), SQUARES)), tuple, PoseLinks, is_optional=True),
    Field("relations", (Column("relation_stamps", ("r", 2), "s"), Column("relation_poses", ("r", 3), POSE)),
         lambda found: (found.stamps, found.poses), Relations, is_optional=True),
    *FINAL,
    GRID,
)  # fmt: skip
"""at the end of the run; K keyframes, S scans, l links, n landmarks in the estimate and N that are known"""


def scene_table(scene: Scene | None) -> dict[str, Any] | None:
    """A scene as a value of JSON."""
    if scene is None:
        return None
    return row_of(SCENE, scene) | {"walkers": [as_table(walk) for walk in scene.walkers]}


def scene_of(table: Mapping[str, Any] | None) -> Scene | None:
    """The scene that such a value describes."""
    if table is None:
        return None
    fields = {field.path: field.join(*(column.from_line(table) for column in field.columns))
              for field in SCENE if field.columns[0].name in table}  # fmt: skip
    walkers = tuple(ScriptedWalk(**walk) for walk in table["walkers"])
    return Scene(**{"start": None, "goal": None, "walkers": walkers} | fields)


def row_of(fields: Iterable[Field], owner: Any, k: int | None = None) -> dict[str, Any]:
    """A line of a table: the row `k` of a trace, or without one a value's own fields."""
    line: dict[str, Any] = {}
    for field in fields:
        value = field.of(owner)
        if field.is_absent(value):
            continue
        kept = field.split(value if k is None or not field.is_row else value[k])
        line |= {column.name: column.to_line(one) for column, one in zip(field.columns, kept, strict=True)}
    return line
