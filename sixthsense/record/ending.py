"""What a run's folder keeps of its end, in arrays: `record.npz`, `landmarks.npz` and `grid.npz`."""

from __future__ import annotations

import contextlib
import csv
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId
from sixthsense.record.reading import RecordError
from sixthsense.record.trace import Trace
from sixthsense.record.writing import whole
from sixthsense.slam.association.crookedness import MeanShape
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.front_end import PoseLinks
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.restore import restore_grid
from sixthsense.sources.logs.relations import Relations
from sixthsense.sources.logs.tum import read_tum

END_FILE, LANDMARKS_FILE, GRID_FILE = "record.npz", "landmarks.npz", "grid.npz"


def write_arrays(folder: Path, trace: Trace) -> None:
    """Write `record.npz`: the final poses of keyframes and scans, what is known of each landmark, and the relations."""
    records = list(trace.records.values())
    arrays: dict[str, Any] = {
        "trajectory": trace.trajectory,
        "since_key": np.reshape(trace.since_key, (-1, 3)),
        "ids": np.array(list(trace.records), dtype=np.int64),
        "kinds": np.array([record.kind for record in records], dtype=np.int64),
        "observations": np.array([record.observations for record in records], dtype=np.int64),
        "first_scans": np.array([record.first_scan for record in records], dtype=np.int64),
        "last_scans": np.array([record.last_scan for record in records], dtype=np.int64),
        "sigmas_m": np.array([record.sigma_m for record in records], dtype=np.float64),
        "extents": np.array([record.extent for record in records], dtype=np.float64).reshape(-1, 2, 2),
        "shapes": np.array([_shape_row(record.shape) for record in records], dtype=np.float64).reshape(-1, 5),
    }
    if trace.relations is not None:
        arrays |= {"relation_stamps": trace.relations.stamps, "relation_poses": trace.relations.poses}
    if trace.links is not None:
        arrays |= {f"link_{name}": values for name, values in trace.links._asdict().items()}
    with whole(folder / END_FILE) as file:
        np.savez_compressed(file, **arrays)


def write_grid(folder: Path, grid: Grid) -> None:
    """Write `grid.npz`: scans that hit and passed each cell, whether it was seen, and where the cells lie."""
    with whole(folder / GRID_FILE) as file:
        np.savez_compressed(file, hits=grid.hits, passes=grid.passes, seen=grid.seen, origin=np.array(grid.origin))


def read_arrays(file: Path, trace: Trace) -> None:
    """Add to the trace what `record.npz` holds; raises RecordError for a file that is damaged."""
    with _loaded(file) as arrays:
        trajectory = _floats(arrays, "trajectory", (len(trace.key_stamps_ns), 3))
        trace.records = _records(arrays)
        trace.trajectory = trajectory
        if "since_key" in arrays:  # not in older records
            trace.since_key = list(_floats(arrays, "since_key", (len(trace.stamps_ns), 3)))
        if "link_ends" in arrays:
            ends = arrays["link_ends"].astype(np.int64).reshape(-1, 2)
            count = len(ends)
            motions, covs = _floats(arrays, "link_motions", (count, 3)), _floats(arrays, "link_covs", (count, 3, 3))
            if count and not 0 <= ends.min() <= ends.max() < len(trajectory):
                raise ValueError(f"link_ends {ends.min()} to {ends.max()} of {len(trajectory)} keyframes")
            trace.links = PoseLinks(ends, motions, covs)
        if "relation_stamps" in arrays:
            stamps = _floats(arrays, "relation_stamps", (-1, 2))
            trace.relations = Relations(stamps, _floats(arrays, "relation_poses", (len(stamps), 3)))


def read_records(file: Path) -> dict[LandmarkId, Record]:
    """What `record.npz` holds of each landmark; raises RecordError for a file that is damaged."""
    with _loaded(file) as arrays:
        return _records(arrays)


def _records(arrays: dict[str, Any]) -> dict[LandmarkId, Record]:
    ids = _integers(arrays, "ids")
    n = len(ids)
    counts = "observations" if "observations" in arrays else "sightings"  # the name in older records
    kinds, observations = _integers(arrays, "kinds", n).tolist(), _integers(arrays, counts, n).tolist()
    first, last = _integers(arrays, "first_scans", n).tolist(), _integers(arrays, "last_scans", n).tolist()
    sigmas_m, extents = arrays["sigmas_m"].astype(np.float64), _floats(arrays, "extents", (n, 2, 2))
    if sigmas_m.shape != (n,):
        raise ValueError(f"sigmas_m of shape {sigmas_m.shape}")
    shapes = _floats(arrays, "shapes", (n, 5)) if "shapes" in arrays else np.zeros((n, 5))  # not in older records
    columns = zip(
        map(Kind, kinds), observations, first, last, sigmas_m.tolist(), extents, map(_shape_of, shapes), strict=True
    )
    return {i: Record(*row) for i, row in zip(ids.tolist(), columns, strict=True)}


def _shape_row(shape: MeanShape) -> tuple[float, ...]:
    return (shape.observations, *shape.information, *shape.weighted)


def _shape_of(row: Array) -> MeanShape:
    count, *values = row.tolist()
    return MeanShape(int(count), (values[0], values[1]), (values[2], values[3]))


def read_landmarks(file: Path, trace: Trace) -> None:
    """Set the trace's final estimate to that in `landmarks.npz`; raises RecordError for a file that is damaged."""
    with _loaded(file) as arrays:
        ids = _integers(arrays, "ids")
        walls = _integers(arrays, "kinds", len(ids)) == Kind.WALL
        size = 3 + 2 * len(ids)
        mean, cov = _floats(arrays, "mean", (size,)), _floats(arrays, "covariance", (size, size))
        pose = Pose.from_array(mean[:3])
        trace.final = Estimate(pose, cov[:3, :3].copy(), ids, mean[3:].reshape(-1, 2), walls)
        trace.joint_cov = cov


def read_grid(file: Path, config: Config, radius_m: float) -> Grid:
    """The map that `grid.npz` holds; raises RecordError for a file that is damaged."""
    with _loaded(file) as arrays:
        hits, passes = arrays["hits"].astype(np.int32), arrays["passes"].astype(np.int32)
        x, y = _floats(arrays, "origin", (2,)).tolist()
        return restore_grid(config.grid, radius_m, (x, y), hits, passes, arrays["seen"].astype(np.bool_))


def read_landmark_table(file: Path) -> dict[LandmarkId, Record]:
    """What `landmarks.csv` tells of each landmark; of a folder that was written before there was a `record.npz`.

    Raises RecordError, naming the line, for a table that is damaged.
    """
    found: dict[LandmarkId, Record] = {}
    number = 1
    try:
        with file.open(newline="", encoding="utf-8") as stream:
            rows = csv.DictReader(stream)
            for row in rows:
                number = rows.line_num
                kind = Kind[row["kind"].upper()]
                ends = [float(row[name] or 0.0) for name in ("from_x", "from_y", "to_x", "to_y")]
                extent = np.array(ends).reshape(2, 2)
                found[int(row["id"])] = Record(
                    kind, int(row.get("observations") or row["sightings"]), 0, 0, extent=extent
                )
    except OSError as error:
        raise RecordError(f"{file}: cannot be read ({error.strerror})") from None
    except (LookupError, TypeError, ValueError, AttributeError, csv.Error):
        raise RecordError(f"{file}: line {number}: found no landmark, allowed: a table of landmarks") from None
    return found


def read_planar_tum(file: Path, rows: int) -> Array:
    """(rows, 3) poses of a TUM trajectory; raises an InputError, naming the line, for a file that is damaged."""
    if rows == 0:
        return np.zeros((0, 3))
    _, poses = read_tum(file)
    if len(poses) != rows:
        raise RecordError(f"{file}: found {len(poses)} poses, allowed: {rows}")
    x, y, _, _, _, z, w = poses.T
    return np.column_stack([x, y, wrap_angle(2.0 * np.arctan2(z, w))])


@contextlib.contextmanager
def _loaded(file: Path) -> Iterator[dict[str, Any]]:
    """The arrays of an NPZ file; whatever is wrong with them within the block is a RecordError."""
    try:
        with np.load(file, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        yield arrays
    except RecordError:
        raise
    except OSError as error:
        raise RecordError(f"{file}: cannot be read ({error.strerror or 'damaged'})") from None
    except KeyError as error:
        raise RecordError(f"{file}: found no array {error.args[0]!r}, allowed: that of a run") from None
    except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, EOFError, MemoryError) as error:
        raise _damaged(file, error) from None
    except (RuntimeError, SyntaxError, zipfile.BadZipFile, zlib.error, struct.error) as error:  # of a damaged ZIP
        raise _damaged(file, error) from None


def _damaged(file: Path, error: Exception) -> RecordError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return RecordError(f"{file}: found {reason[:160]}, allowed: the arrays of a run")


def _integers(arrays: dict[str, Any], name: str, count: int | None = None) -> Any:
    array = arrays[name]
    if array.dtype.kind != "i" or array.ndim != 1 or count not in (None, len(array)):
        raise ValueError(f"{name} of shape {array.shape} and type {array.dtype}")
    return array.astype(np.int64)


def _floats(arrays: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    """The finite numbers of that name in that shape, in which a first length of -1 is any."""
    array = arrays[name]
    expected = (*array.shape[:1], *shape[1:]) if shape[0] == -1 else shape
    if array.dtype.kind != "f" or array.shape != expected or not np.isfinite(array).all():
        raise ValueError(f"{name} of shape {array.shape} and type {array.dtype}")
    return np.asarray(array, dtype=np.float64)
