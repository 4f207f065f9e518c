"""A run's record in its folder: written while it goes on and at its end, and read back without estimating again.

`record.jsonl` grows with the run, a JSON object per line: first format, robot's radius and scene, then keyframes, plans
and scans in batches, those of a kind in order and one kind after the other. `record.npz` is there as a whole when the
run has ended. A killed run has none, and its last line may be cut.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import hashlib
import json
import math
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config, load_config, prior_map_of
from sixthsense.config.errors import InputError, reason_of
from sixthsense.config.files import absolute, instead_of, path_of
from sixthsense.config.section import shown
from sixthsense.core.covariance import COVARIANCE_SLACK, covariance_fault
from sixthsense.core.geometry import Pose
from sixthsense.record.columns import (
    END,
    FINAL,
    FORMAT,
    GRID,
    KEYFRAME,
    PLAN,
    SCAN,
    Field,
    Sizes,
    row_of,
    scene_of,
    scene_table,
)
from sixthsense.record.trace import Trace
from sixthsense.record.writing import naming, whole
from sixthsense.slam.estimators import LandmarkPrior
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.submap import Submap
from sixthsense.slam.prior_map import PriorMap, PriorStart
from sixthsense.verdict.verdict import Cause, Level, Verdict

FILE, END_FILE, VERDICT_FILE = "record.jsonl", "record.npz", "verdict.json"
_TABLES = {fields[0].columns[0].name: fields for fields in (KEYFRAME, PLAN, SCAN)}
"""tables of `record.jsonl` by the first column of their lines, in the order in which they are written"""

Line = dict[str, Any]


class RecordPart(enum.Enum):
    """A part of the record that a run folder may lack; its value describes it to a user."""

    END = f"the run's end: outcome, counts, clocks, final trajectory and landmarks ({END_FILE})"
    """missing from a run that was killed; each keyframe keeps the pose estimated at its time"""
    GRID = f"the grid map ({END_FILE})"


@contextlib.contextmanager
def record_writer(folder: Path) -> Iterator[Callable[[Trace], None]]:
    """Begin `FOLDER/record.jsonl`: what it gives writes all that a trace has gained since the last call.

    The block's end writes the rest; after an OSError what was written stays as it is. A killed run loses what its trace
    has gained since the last call. Raises OSError, naming the file, when it cannot be written.
    """
    file, latest = folder / FILE, None
    written = dict.fromkeys(_TABLES, 0)
    stream = file.open("w", encoding="utf-8")

    def flush(trace: Trace) -> None:
        nonlocal latest
        lines: list[Line] = []
        if latest is None:
            lines = [{"format": FORMAT, "radius_m": trace.radius_m, "scene": scene_table(trace.scene)}]
        latest = trace
        for name, fields in _TABLES.items():
            count = len(fields[0].of(trace))
            lines += [row_of(fields, trace, k) for k in range(written[name], count)]
            written[name] = count
        with naming(file):
            stream.write("".join(f"{_to_json(line)}\n" for line in lines))
            stream.flush()

    try:
        yield flush
    except OSError:
        latest = None
        raise
    finally:
        try:
            if latest is not None:
                flush(latest)
        finally:
            with contextlib.suppress(OSError):
                stream.close()


_to_json = json.JSONEncoder(separators=(",", ":")).encode


def write_end(folder: Path, trace: Trace) -> None:
    """Write `record.npz`, the end of a run, and before it the whole `record.jsonl` if none was streamed there.

    One array at a time is in memory, in the form of `numpy.savez_compressed`.
    """
    if not (folder / FILE).exists():
        with record_writer(folder) as flush:
            flush(trace)
    # Of a large map level 1 takes a third of the time of the usual one, and a fifth more room.
    with whole(folder / END_FILE) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as out:
        for field in END:
            kept = field.of(trace)
            if field.is_absent(kept):
                continue
            values = iter(field.split(kept))
            for column in field.columns:
                with out.open(f"{column.name}.npy", "w", force_zip64=True) as member:
                    # Named nowhere, so that it is gone before the next one is made.
                    np.lib.format.write_array(member, column.array(next(values)), allow_pickle=False)


def load_record(folder: Path | str) -> tuple[Trace, tuple[RecordPart, ...]]:
    """Read the record in the folder of a run, or in the `.partial` that a killed run has left; and what it lacks.

    Lists of missing fields are empty, a missing grid is None. The estimates at keyframes are read without their
    landmarks, which no folder holds. The outcome of a killed run is "interrupted". Raises an InputError that names file
    and line for a folder that is no run folder, has recorded nothing, or is damaged.
    """
    folder = Path(folder)
    config = load_config(folder / "config.toml")
    trace = _read_stream(folder / FILE, config)
    trace.prior_map = prior_map_of(folder / "config.toml")
    trace.name = absolute(folder).name.removesuffix(".partial")
    if (folder / VERDICT_FILE).exists():
        trace.verdict = read_verdict(folder / VERDICT_FILE)
    if (folder / END_FILE).exists():
        _read_end(folder / END_FILE, trace)
        return trace, () if trace.grid is not None else (RecordPart.GRID,)
    trace.outcome = "interrupted"
    trace.last_position = (trace.truths or trace.odometry)[-1][:2]
    if trace.key_estimates:
        trace.final, trace.joint_cov = trace.key_estimates[-1], trace.key_estimates[-1].pose_cov
    trace.trajectory = np.array([estimate.pose.array() for estimate in trace.key_estimates]).reshape(-1, 3)
    return trace, (RecordPart.END, RecordPart.GRID)


def _read_stream(file: Path, config: Config) -> Trace:
    """The trace that a `record.jsonl` holds; InputError for a damaged line and for a record without a scan."""
    trace: Trace | None = None
    try:
        with file.open("rb") as stream:
            for number, line in enumerate(stream, start=1):
                if not line.endswith(b"\n"):
                    break  # a killed writer has cut it
                try:
                    table = _table(line)
                    if trace is None:
                        trace = _begun(table, config)
                    else:
                        _take(table, trace)
                except (LookupError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
                    found = str(error) if isinstance(error, ValueError) else shown(line)
                    allowed = "a line of a run's record"
                    raise InputError(file, f"line {number}: found {' '.join(found.split())}", allowed) from None
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})") from None
    if trace is None or not trace.stamps_ns:
        raise InputError(file, "found no scan", "the record of a run")
    return trace


def _table(line: bytes) -> Line:
    try:
        table = json.loads(line)
    except ValueError:
        raise ValueError("no JSON") from None
    if not isinstance(table, dict):
        raise ValueError("no table")
    return table


def _begun(table: Line, config: Config) -> Trace:
    """The trace of a run that has begun, from the first line."""
    if table.get("format") != FORMAT:
        raise ValueError(f"format {shown(table.get('format'))}, not {FORMAT}")
    return Trace(config, scene_of(table["scene"]), float(table["radius_m"]))


def _take(table: Line, trace: Trace) -> None:
    """Add what a line tells to the trace."""
    name = next((name for name in _TABLES if name in table), None)
    if name is None:
        raise ValueError(f"a line without any of {', '.join(_TABLES)}")
    fields = _TABLES[name]
    for field in fields:
        values = field.of(trace)
        if field.is_optional and field.columns[0].name not in table:
            if field.is_row and values:
                raise ValueError(f"no {field.columns[0].name}, which other lines have")
            continue
        value = field.join(*(column.from_line(table) for column in field.columns))
        if not field.is_row:
            field.put(trace, value)
            continue
        values.append(value)
        if len(values) != len(fields[0].of(trace)):
            raise ValueError(f"{field.columns[0].name}, which other lines have not")
    stamps = fields[0].of(trace)
    if fields is not PLAN and len(stamps) > 1 and stamps[-1] <= stamps[-2]:
        raise ValueError(f"{name} at {stamps[-1]} ns after {stamps[-2]} ns")
    if fields is SCAN and trace.last_key[-1] >= len(trace.key_stamps_ns):
        raise ValueError(f"last_key {trace.last_key[-1]} after {len(trace.key_stamps_ns)} keyframes")


def _read_end(file: Path, trace: Trace) -> None:
    """Add to the trace what `record.npz` holds; raises InputError for a file that is damaged."""
    with _loaded(file) as arrays:
        _read_parts(END, arrays, trace, {"K": len(trace.key_stamps_ns), "S": len(trace.stamps_ns)})
        if trace.links is not None and trace.links.ends.max(initial=0) >= max(1, len(trace.trajectory)):
            raise ValueError(f"link_ends to {trace.links.ends.max()} of {len(trace.trajectory)} keyframes")


def _read_parts(fields: Iterable[Field], arrays: Any, trace: Trace, sizes: Sizes) -> None:
    """Set the fields of the trace that are kept in these arrays."""
    for field in fields:
        if field.is_optional and field.columns[0].name not in arrays:
            continue
        field.put(trace, field.join(*(column.checked(arrays[column.name], sizes) for column in field.columns)))
        if field is GRID:
            trace.grid = _grid(trace, *field.of(trace))
    final, size = trace.final, sizes["d"]
    if size != 3 + 2 * len(final.ids):
        raise ValueError(f"a covariance of {size} rows with {len(final.ids)} landmarks")
    if not set(final.ids.tolist()) <= set(trace.records):
        raise ValueError("landmarks that are in no record of them")
    trace.final = dataclasses.replace(final, pose_cov=trace.joint_cov[:3, :3].copy())


def _grid(trace: Trace, hits: NDArray[Any], passes: NDArray[Any], seen: NDArray[Any], origin: NDArray[Any]) -> Grid:
    counts = hits.astype(np.int32), passes.astype(np.int32)
    x, y = origin.tolist()
    return Grid.from_counts(trace.config.grid, trace.radius_m, (x, y), *counts, seen)


@contextlib.contextmanager
def _loaded(file: Path) -> Iterator[Any]:
    """The arrays of an NPZ file; whatever is wrong with them within the block is an InputError."""
    try:
        with np.load(file, allow_pickle=False) as content:
            yield content
    except InputError:
        raise
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror or 'damaged'})") from None
    except KeyError as error:
        raise InputError(file, f"found {error.args[0]}", "the arrays of a run") from None
    except Exception as error:  # a damaged file makes its readers fail with undocumented exceptions
        raise InputError(file, f"found {reason_of(error)}", "the arrays of a run") from None


def read_prior_map(folder: Path | str) -> PriorMap:
    """The map in the folder of a run that has ended.

    Raises InputError, naming the file, for a folder that is no run folder, lacks a part of the map, or is damaged, and
    for a map without landmarks.
    """
    folder = path_of("prior_map", folder)
    file = folder / END_FILE
    if not (folder / "config.toml").is_file():
        raise InputError(folder, f"found {instead_of(folder, 'config.toml')}", "the folder of a run")
    if not file.is_file():
        raise InputError(folder, f"found no {END_FILE}", "the folder of a run that has ended")
    config = load_config(folder / "config.toml")
    trace, digest = Trace(config, None, 0.0), hashlib.sha256()
    fields = (*FINAL, GRID)
    with _loaded(file) as arrays:
        _read_parts(fields, arrays, trace, {})
        for name in (column.name for field in fields for column in field.columns):
            digest.update(arrays[name].tobytes() if name in arrays else b"")
    final, cov = trace.final, trace.joint_cov[3:, 3:]
    if not len(final.ids):
        raise InputError(folder, "found a map without landmarks", "one by the front end of landmarks")
    if len(np.unique(final.ids)) != len(final.ids):
        raise InputError(file, "found a landmark twice", "those of one run")
    if fault := covariance_fault(cov, lowest=-COVARIANCE_SLACK):
        raise InputError(file, f"found {fault}", "a covariance")
    kept = {i: trace.records[i] for i in final.ids.tolist()}
    extents = np.array([record.extent for record in kept.values()])
    landmarks = LandmarkPrior(final.ids, final.landmarks, final.walls, cov, extents)
    none = np.zeros(0, np.int32)
    evidence = Submap.of(np.zeros((0, 2), np.int64), none, none, np.zeros(0, np.bool_))
    if trace.grid is not None:
        evidence = trace.grid.submap()
    return PriorMap(folder.resolve().name, digest.hexdigest(), landmarks, kept, evidence, config.grid.cell_m)


def prior_start(
    folder: Path | str | None,
    pose: Sequence[float] | None,
    sigma: Sequence[float] | None,
    lost: bool = False,
) -> PriorStart | None:
    """The prior map in `folder` and the start in it, None without a folder. A robot that is `lost` has no pose.

    Raises InputError for a pose or sigmas that are not allowed, and without a folder; InputError as `read_prior_map`.
    """
    given = {name: value for name, value in (("pose", pose), ("pose_sigma", sigma)) if value is not None}
    if folder is None:
        for name in ("lost",) if lost else given:
            raise InputError(name, "found without `prior_map`", "with it")
        return None
    for name, value in given.items():
        is_number = [isinstance(number, int | float) and math.isfinite(number) for number in value]
        if len(value) != 3 or not all(is_number):
            raise InputError(name, f"found {' '.join(map(str, value))}", "three finite numbers")
        if lost:
            raise InputError(name, "found with `lost`", "one of both")
    if sigma is not None and min(sigma) < 0.0:
        raise InputError("pose_sigma", f"found {' '.join(map(str, sigma))}", "at least 0")
    x, y, theta = (0.0, 0.0, 0.0) if sigma is None else map(float, sigma)
    there = None if pose is None else Pose.from_array(np.array(pose, dtype=np.float64))
    return PriorStart(read_prior_map(folder), there, (x, y, theta), lost)


def write_verdict(file: Path, verdict: Verdict) -> None:
    """Write a verdict; stamps are seconds since the first scan, places metres in the world frame."""
    table = {
        "level": verdict.level,
        "probability": verdict.probability,
        "causes": [cause._asdict() | {"places": cause.places.tolist()} for cause in verdict.causes],
        "evidence": dict(verdict.evidence),
        "keyframes": verdict.keyframes.round(6).tolist(),
    }
    with whole(file) as unfinished:
        unfinished.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_verdict(file: Path) -> Verdict:
    """The verdict in a file; InputError for one that is damaged."""
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
        if table["level"] not in get_args(Level):
            raise ValueError(f"level {table['level']!r}")
        keyframes = np.array(table["keyframes"], dtype=np.float64).reshape(-1)
        causes = tuple(
            Cause(str(row["name"]), str(row["sentence"]), float(row["from_s"]), float(row["to_s"]),
                  np.array(row["places"], dtype=np.float64).reshape(-1, 2))
            for row in table["causes"]
        )  # fmt: skip
        evidence = {str(name): float(value) for name, value in table["evidence"].items()}
        return Verdict(table["level"], float(table["probability"]), keyframes, causes, evidence)
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})") from None
    except Exception as error:  # of a damaged file
        raise InputError(file, f"found {reason_of(error)}", "the verdict on a run") from None
