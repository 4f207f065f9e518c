"""The fields of a trace that a record has, as rows and values of JSON, and back by the types of the trace's fields."""

from __future__ import annotations

import functools
import typing
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, create_model
from pydantic_core import to_jsonable_python

from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid

BEGIN = ("scene", "radius_m")
"""what is known before the first tick; the scene outlives its file"""
SCAN = ("log_stamps_s", "estimates", "odometry", "truths", "walkers", "last_key", "since_key", "since_covs")
"""lists with a value per scan, which are rows; one that is empty has no column"""
KEYFRAME = (
    *("key_truths", "key_measured", "key_odometry", "key_predicted", "key_estimates"),
    *("associations", "walls_found"),
)
"""lists with a value per keyframe, of JSON; one that is empty is left out"""
END = (
    *("outcome", "path_length_m", "wall_time_s", "last_position", "culled", "walls_merged", "plans_below_margin"),
    *("plans_by_astar", "guard_stops", "loop_closures", "wheels", "sensor", "left", "verdict", "trajectory", "final"),
    *("joint_cov", "records", "links", "relations"),
)
"""what is known when a run has ended"""

_LARGEST = 64  # numbers of an array within JSON

Arrays = Mapping[str, NDArray[Any]]


def packed(value: Any, arrays: dict[str, NDArray[Any]] | None = None) -> Any:
    """A value as one of JSON: an array is `{"array": [type, shape, numbers]}`.

    A large one is added to `arrays`, if there are some, and `{"channel": name}` takes its place.
    """

    def of_numpy(found: Any) -> Any:
        if isinstance(found, np.generic):
            return found.item()
        if arrays is None or found.size <= _LARGEST:
            return {"array": [found.dtype.str, found.shape, found.ravel().tolist()]}
        arrays[f"array.{len(arrays)}"] = found
        return {"channel": f"array.{len(arrays) - 1}"}

    return to_jsonable_python(value, fallback=of_numpy)


def _unpacked(value: Any, arrays: Arrays) -> Any:
    """The arrays in a value of JSON in their places."""
    if isinstance(value, list):
        return [_unpacked(one, arrays) for one in value]
    if not isinstance(value, dict):
        return value
    if "channel" in value:
        return arrays[value["channel"]]
    if "array" in value:
        kind, shape, numbers = value["array"]
        return np.array(numbers, kind).reshape(shape)
    return {name: _unpacked(one, arrays) for name, one in value.items()}


@functools.cache
def _model(names: tuple[str, ...]) -> type[BaseModel]:
    """A model with these fields of a trace."""
    hints = typing.get_type_hints(Trace)
    fields: dict[str, Any] = {name: (hints[name], ...) for name in names}
    return create_model("Fields", __config__=ConfigDict(arbitrary_types_allowed=True), **fields)


def read_fields(table: Mapping[str, Any], arrays: Arrays = MappingProxyType({})) -> dict[str, Any]:
    """The values of fields of a trace, by name, that `packed` has made; ValueError for others."""
    return dict(_model(tuple(table))(**{name: _unpacked(value, arrays) for name, value in table.items()}))


def scan_row(trace: Trace, k: int) -> NDArray[Any]:
    """(1,) row of a scan, with the length of the path and the touches so far."""
    columns = {name: values[k] for name in SCAN if (values := getattr(trace, name))}
    columns |= {"path_length_m": trace.path_length_m} | ({} if trace.touches is None else {"touches": trace.touches})
    arrays = {name: np.asarray(value) for name, value in columns.items()}
    return np.array([tuple(arrays.values())], [(name, array.dtype, array.shape) for name, array in arrays.items()])


def read_scans(trace: Trace, rows: NDArray[Any]) -> None:
    """Set in a trace what the rows of all scans have."""
    names = rows.dtype.names or ()
    for name in set(SCAN) & set(names):
        setattr(trace, name, rows[name].tolist() if rows[name].ndim == 1 else list(rows[name]))
    if "touches" in names:
        trace.touches = tuple(rows["touches"][-1].tolist())
    trace.path_length_m = float(rows["path_length_m"][-1])


def keyframe_table(trace: Trace, k: int) -> Any:
    """The values of a keyframe, whose estimate is that of the pose alone, and the times of its stages."""
    values = {name: found[k] for name in KEYFRAME if (found := getattr(trace, name))}
    estimate, watch = trace.key_estimates[k], trace.stopwatch
    values["key_estimates"] = Estimate.of_pose(estimate.pose, estimate.pose_cov)
    return packed({"fields": values, "ms": watch.rows[k], "total_ms": watch.totals})


def read_keyframes(trace: Trace, tables: Sequence[Mapping[str, Any]]) -> None:
    """Set in a trace what the tables of all keyframes have."""
    columns = {name: [table["fields"][name] for table in tables] for name in tables[0]["fields"]}
    for name, values in read_fields(columns).items():
        setattr(trace, name, values)
    trace.stopwatch.rows, trace.stopwatch.totals = [table["ms"] for table in tables], tables[-1]["total_ms"]


def end_table(trace: Trace, metrics: Mapping[str, Any], arrays: dict[str, NDArray[Any]]) -> Any:
    """The values of a run that has ended; large arrays are added to `arrays`."""
    values = {name: getattr(trace, name) for name in END}
    since_key, grid = np.array(trace.since_key).reshape(-1, 3), trace.grid
    cells = grid and [counts.astype(np.min_scalar_type(counts.max(initial=0))) for counts in (grid.hits, grid.passes)]
    more = {"since_key": since_key, "grid": grid and {"origin": grid.origin, "counts": [*(cells or ()), grid.seen]}}
    return packed({"fields": values, **more, "total_ms": trace.stopwatch.totals, "metrics": dict(metrics)}, arrays)


def read_end(trace: Trace, table: Mapping[str, Any], arrays: Arrays) -> None:
    """Set in a trace what `end_table` has of it."""
    for name, value in read_fields(table["fields"], arrays).items():
        setattr(trace, name, value)
    trace.stopwatch.totals, trace.since_key = table["total_ms"], list(_unpacked(table["since_key"], arrays))
    ids = trace.final.ids.tolist()
    if len(trace.joint_cov) != 3 + 2 * len(ids) or not set(ids) <= set(trace.records):
        raise ValueError("landmarks without a record, or a covariance of other landmarks")
    if (grid := _unpacked(table["grid"], arrays)) is not None:
        hits, passes, seen = grid["counts"]
        counts = hits.astype(np.int32), passes.astype(np.int32), seen
        trace.grid = Grid.from_counts(trace.config.grid, trace.radius_m, tuple(grid["origin"]), *counts)
