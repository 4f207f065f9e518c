"""What a run has estimated as rows and values of JSON, and back: the content of a record's channels."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.config import as_table
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind
from sixthsense.core.motion import Odometry
from sixthsense.logs.log import Relations
from sixthsense.logs.runfolder import observations_of
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.record.trace import STAGES, Trace
from sixthsense.simulation.scene import Scene
from sixthsense.simulation.scene_files import ScriptedWalk
from sixthsense.slam.association.records import Association, Record
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.front_end import LoopClosureCounts, PoseLinks
from sixthsense.slam.mapping.grid import Grid
from sixthsense.verdict.verdict import Cause, Verdict

SCAN = ("log_stamps_s", "estimates", "odometry", "truths", "walkers", "last_key", "since_key", "since_covs")
"""lists of the trace with a value per scan; one that is empty has no column"""
KEYFRAME = ("key_truths", "key_measured")
"""the same with a value per keyframe"""
END = ("outcome", "path_length_m", "wall_time_s", "last_position", "culled", "walls_merged", "plans_below_margin",
       "plans_by_astar", "guard_stops", "loop_closures", "wheels", "sensor")  # fmt: skip
"""small values of the trace"""


def rows_of(**columns: ArrayLike) -> NDArray[Any]:
    """(n,) rows of columns with n values each."""
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    rows = np.zeros(
        len(next(iter(arrays.values()))), [(name, array.dtype, array.shape[1:]) for name, array in arrays.items()]
    )
    for name, array in arrays.items():
        rows[name] = array
    return rows


def scan_row(trace: Trace, k: int) -> NDArray[Any]:
    """(1,) row of a scan, with the length of the path and the touches so far."""
    columns = {name: [values[k]] for name in SCAN if (values := getattr(trace, name))}
    touches = {} if trace.touches is None else {"touches": [trace.touches]}
    return rows_of(**columns, **touches, path_length_m=[trace.path_length_m])


def read_scans(trace: Trace, rows: NDArray[Any]) -> None:
    """Add the rows of all scans to a trace."""
    _read_lists(trace, SCAN, rows)
    if "touches" in (rows.dtype.names or ()):
        trace.touches = tuple(rows["touches"][-1].tolist())
    trace.path_length_m = float(rows["path_length_m"][-1])


def _read_lists(trace: Trace, names: Iterable[str], rows: NDArray[Any]) -> None:
    for name in names:
        if name in (rows.dtype.names or ()):
            setattr(trace, name, rows[name].tolist() if rows[name].ndim == 1 else list(rows[name]))


def keyframe_row(trace: Trace, k: int) -> NDArray[Any]:
    """(1,) row of a keyframe; stages that were not timed are NaN."""
    motion, found, watch = trace.key_odometry[k], trace.associations[k], trace.stopwatch
    columns = {name: [values[k]] for name in KEYFRAME if (values := getattr(trace, name))}
    for name, estimate in (("predicted", trace.key_predicted[k]), ("pose", trace.key_estimates[k])):
        columns |= {name: [estimate.pose.array()], f"{name}_cov": [estimate.pose_cov]}
    return rows_of(
        motion=[motion.motion.array()],
        motion_cov=[motion.cov],
        **columns,
        counts=[(found.discarded, found.dof, found.fused)],
        nis=[float(found.nis)],
        ms=[[watch.rows[k].get(stage, np.nan) for stage in STAGES]],
        total_ms=[[watch.totals[stage] for stage in STAGES]],
    )


def read_keyframes(trace: Trace, rows: NDArray[Any], observed: Sequence[NDArray[Any]]) -> None:
    """Add the rows of all keyframes to a trace, with the observations of each."""
    _read_lists(trace, KEYFRAME, rows)
    for row, seen in zip(rows, observed, strict=True):
        discarded, dof, fused = row["counts"].tolist()
        trace.associations.append(Association(observations_of(seen), discarded, float(row["nis"]), dof, fused))
        trace.key_odometry.append(Odometry(Pose.from_array(row["motion"]), row["motion_cov"]))
        trace.key_predicted.append(Estimate.of_pose(Pose.from_array(row["predicted"]), row["predicted_cov"]))
        trace.key_estimates.append(Estimate.of_pose(Pose.from_array(row["pose"]), row["pose_cov"]))
        times = zip(STAGES, row["ms"].tolist(), strict=True)
        trace.stopwatch.rows.append({stage: ms for stage, ms in times if ms == ms})
    trace.stopwatch.totals = dict(zip(STAGES, rows["total_ms"][-1].tolist(), strict=True))


def end_arrays(trace: Trace) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays of a run that has ended, by channel, one at a time: a large map is most of the memory of a run."""
    final, links, relations, records = trace.final, trace.links, trace.relations, trace.records.values()
    yield "trajectory", trace.trajectory
    yield "final_since_key", np.array(trace.since_key).reshape(-1, 3)
    yield "landmarks", rows_of(landmark=final.ids, is_wall=final.walls, mean=final.landmarks)
    yield "joint_cov", trace.joint_cov
    if records:
        yield (
            "records",
            rows_of(
                landmark=list(trace.records),
                counts=[(int(one.kind), one.observations, one.first_scan, one.last_scan) for one in records],
                extent=[one.extent for one in records],
            ),
        )
    if links is not None:
        yield "links", rows_of(ends=links.ends, motion=links.motions, cov=links.covs)
    if relations is not None:
        yield "relations", rows_of(stamps=relations.stamps, pose=relations.poses)
    if trace.grid is not None:
        for name, counts in (("hits", trace.grid.hits), ("passes", trace.grid.passes)):
            yield f"grid.{name}", counts.astype(np.min_scalar_type(int(counts.max(initial=0))))
        yield "grid.seen", trace.grid.seen


def end_table(trace: Trace, metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The small values of a run that has ended, as a value of JSON with arrays."""
    verdict = trace.verdict
    judged = verdict and {**_fields(verdict), "causes": [cause._asdict() for cause in verdict.causes]}
    return {name: getattr(trace, name) for name in END} | {
        "total_ms": trace.stopwatch.totals,
        "pose": trace.final.pose.array(),
        "grid_origin": trace.grid and trace.grid.origin,
        "left": [_fields(place) for place in trace.left],
        "verdict": judged,
        "metrics": dict(metrics),
    }


def read_end(trace: Trace, table: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Set in a trace what `end_table` and `end_arrays` have of it."""
    for name in END:
        setattr(trace, name, table[name])
    for name in ("last_position", "wheels", "sensor"):
        setattr(trace, name, None if table[name] is None else np.array(table[name], dtype=np.float64))
    trace.loop_closures = table["loop_closures"] and LoopClosureCounts(*table["loop_closures"])
    trace.stopwatch.totals = table["total_ms"]
    trace.left = [UnseenPlace(**place) for place in table["left"]]
    trace.verdict = verdict_of(table)
    trace.trajectory, trace.joint_cov = arrays["trajectory"], arrays["joint_cov"]
    trace.since_key = list(arrays["final_since_key"])
    found, pose_cov = arrays["landmarks"], trace.joint_cov[:3, :3].copy()
    trace.final = Estimate(
        Pose(*table["pose"]), pose_cov, found["landmark"].copy(), found["mean"].copy(), found["is_wall"].copy()
    )
    trace.records = {int(row["landmark"]): _record(row) for row in arrays.get("records", ())}
    if len(trace.joint_cov) != 3 + 2 * len(found) or not set(found["landmark"].tolist()) <= set(trace.records):
        raise ValueError("landmarks without a record, or a covariance of other landmarks")
    if (links := arrays.get("links")) is not None:
        trace.links = PoseLinks(links["ends"].copy(), links["motion"].copy(), links["cov"].copy())
    if (relations := arrays.get("relations")) is not None:
        trace.relations = Relations(relations["stamps"].copy(), relations["pose"].copy())
    if table["grid_origin"] is not None:
        hits, passes = (arrays[name].astype(np.int32) for name in ("grid.hits", "grid.passes"))
        counts = hits, passes, arrays["grid.seen"]
        trace.grid = Grid.from_counts(trace.config.grid, trace.radius_m, tuple(table["grid_origin"]), *counts)


def verdict_of(table: Mapping[str, Any]) -> Verdict | None:
    """The verdict in what `end_table` made of a run."""
    if (verdict := table["verdict"]) is None:
        return None
    causes = tuple(Cause(**cause | {"places": _array(cause["places"], 2)}) for cause in verdict["causes"])
    return Verdict(**verdict | {"causes": causes, "keyframes": np.array(verdict["keyframes"])})


def _record(row: Any) -> Record:
    kind, observations, first, last = row["counts"].tolist()
    return Record(Kind(kind), observations, first, last, row["extent"].copy())


def scene_table(scene: Scene | None) -> dict[str, Any] | None:
    """A scene as a value of JSON with arrays: it outlives its file."""
    if scene is None:
        return None
    start = None if scene.start is None else scene.start.array()
    return _fields(scene) | {"start": start, "walkers": [as_table(walk) for walk in scene.walkers]}


def scene_of(table: Mapping[str, Any] | None) -> Scene | None:
    """The inverse of `scene_table`."""
    if table is None:
        return None
    fields: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in table.items()}
    fields |= {"walls": table["walls"], "glass": _array(table["glass"], 2, 2), "tour": tuple(map(tuple, table["tour"]))}
    fields["start"] = None if table["start"] is None else Pose(*table["start"])
    fields["walkers"] = tuple(ScriptedWalk(**walk) for walk in table["walkers"])
    return Scene(**fields)


def _array(values: Iterable[Any], *shape: int) -> NDArray[Any]:
    return np.array(values, dtype=np.float64).reshape(-1, *shape)


def _fields(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
