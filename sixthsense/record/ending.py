"""The files that a run's folder keeps of its end: written, and its arrays read back."""

from __future__ import annotations

import contextlib
import csv
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.config.errors import InputError, reason_of
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId
from sixthsense.record.factors import factor_graph, links_of, write_graph
from sixthsense.record.reading import checked
from sixthsense.record.stream import write_end
from sixthsense.record.trace import Trace
from sixthsense.record.verdict_file import write_verdict
from sixthsense.record.writing import whole
from sixthsense.slam.association.records import MeanShape, Record
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.front_end import PoseLinks
from sixthsense.slam.mapping.grid import Grid
from sixthsense.sources.logs.log import Relations

_COUNTS = {"kinds": "kind", "observations": "observations", "first_scans": "first_scan", "last_scans": "last_scan"}
"""fields of a landmark's record by the names of their arrays"""
END_FILE, LANDMARKS_FILE, GRID_FILE, VERDICT_FILE = "record.npz", "landmarks.npz", "grid.npz", "verdict.json"


def write_ending(folder: Path, trace: Trace, metrics: Mapping[str, Any]) -> None:
    """Write all files of a finished run but the figures; of the record its end, or all if it was not streamed."""
    write_tum(folder / "estimate.tum", trace.stamps_ns, np.array(trace.estimates))
    write_tum(folder / "smoothed.tum", trace.key_stamps_ns, trace.trajectory)
    if trace.truths:
        write_tum(folder / "truth.tum", trace.stamps_ns, np.array(trace.truths))
    write_landmarks(folder, trace)
    write_graph(folder, factor_graph(trace), links_of(trace))
    write_arrays(folder, trace)
    if trace.grid is not None:
        grid = trace.grid
        write_grid(folder, grid)
        write_map(folder, grid.occupancy(), grid.origin, trace.config.grid.cell_m)
    if trace.outcome.startswith("explored"):
        write_places_left(folder / "places_left.csv", trace)
    if trace.verdict is not None:
        write_verdict(folder / VERDICT_FILE, trace.verdict)
    with whole(folder / "metrics.json") as file:
        file.write_text(json.dumps(metrics, indent=1) + "\n", encoding="utf-8")
    write_end(folder, trace)


def write_grid(folder: Path, grid: Grid) -> None:
    """Write `grid.npz`: the evidence of all cells, and where they are.

    One array at a time, as `numpy.savez_compressed` writes them: a large map would be the most memory of a run.
    """
    arrays: dict[str, Callable[[], NDArray[Any]]] = {
        "hits": lambda: grid.narrow("hits"),
        "passes": lambda: grid.narrow("passes"),
        "seen": lambda: grid.seen,
        "origin": lambda: np.array(grid.origin),
    }
    with whole(folder / GRID_FILE) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as out:
        for name, made in arrays.items():
            with out.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, made(), allow_pickle=False)


def write_tum(file: Path, stamps_ns: list[int], poses: Array) -> None:
    """Write (N, 3) poses as a TUM trajectory: stamp x y z qx qy qz qw, with all digits of the stamps, seconds."""
    with whole(file) as unfinished, unfinished.open("w", encoding="utf-8") as out:
        for stamp, (x, y, theta) in zip(stamps_ns, poses.reshape(-1, 3), strict=True):
            out.write(tum_line(stamp, x, y, theta))


def tum_line(stamp_ns: int, x: float, y: float, theta: float) -> str:
    """A pose as a line of a TUM trajectory."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    half = 0.5 * theta
    return f"{seconds}.{nanoseconds:09d} {x:.17g} {y:.17g} 0 0 0 {np.sin(half):.17g} {np.cos(half):.17g}\n"


def write_places_left(file: Path, trace: Trace) -> None:
    """Write the unseen places of an exploration, the largest first; in m and m^2."""
    with whole(file) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(["x", "y", "area_m2", "reason", "gap_m"])
        writer.writerows([place.x, place.y, place.area_m2, place.reason, place.gap_m] for place in trace.left)


LANDMARK_COLUMNS = (
    "x", "y", "cov_xx", "cov_xy", "cov_yy", "alpha", "d", "cov_alpha_alpha", "cov_alpha_d", "cov_d_d"
)  # fmt: skip


def write_landmarks(folder: Path, trace: Trace) -> None:
    """Write `landmarks.csv`, and the joint mean and covariance as `landmarks.npz`."""
    estimate, records = trace.final, trace.records
    with whole(folder / "landmarks.csv") as file, file.open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(["id", "kind", *LANDMARK_COLUMNS, "observations", "from_x", "from_y", "to_x", "to_y"])
        for k, i in enumerate(estimate.ids.tolist()):
            block = trace.joint_cov[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k]
            record = records[i]
            values = [*estimate.landmarks[k].tolist(), *map(float, (block[0, 0], block[0, 1], block[1, 1]))]
            # A point has x and y. A wall has alpha and d, and the extent of its seen part.
            columns = [""] * 5 + values if estimate.walls[k] else values + [""] * 5
            extent = record.extent.ravel().tolist() if estimate.walls[k] else [""] * 4
            writer.writerow([i, record.kind.name.lower(), *columns, record.observations, *extent])
    with whole(folder / "landmarks.npz") as file:
        np.savez(
            file,
            ids=estimate.ids,
            kinds=np.array([records[i].kind for i in estimate.ids.tolist()], dtype=np.int64),
            mean=np.concatenate([estimate.pose.array(), estimate.landmarks.ravel()]),
            covariance=trace.joint_cov,
        )


def write_map(folder: Path, occupancy: NDArray[np.int8], origin: tuple[float, float], cell_m: float) -> None:
    """Write (H, W) occupancy (-1 unknown, 0 free, 100 occupied) as map_server's PGM and YAML.

    The image is cropped to the known cells.
    """
    import yaml

    rows, cols = (np.flatnonzero(occupancy.max(axis=axis, initial=-1) >= 0) for axis in (1, 0))
    if len(rows) == 0:
        return
    r0, c0 = int(rows[0]), int(cols[0])
    part = occupancy[r0 : rows[-1] + 1, c0 : cols[-1] + 1]
    with whole(folder / "map.pgm") as file, file.open("wb") as out:
        out.write(b"P5\n%d %d\n255\n" % part.shape[::-1])
        for row in part[::-1]:  # the first row of an image is the top of the map
            out.write(np.select([row == 0, row == 100], [np.uint8(254), np.uint8(0)], np.uint8(205)).tobytes())
    meta = {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": cell_m,
        "origin": [origin[0] + c0 * cell_m, origin[1] + r0 * cell_m, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    with whole(folder / "map.yaml") as file:
        file.write_text(yaml.safe_dump(meta, sort_keys=False), encoding="utf-8")


def write_arrays(folder: Path, trace: Trace) -> None:
    """Write `record.npz`: the final poses of keyframes and scans, what is known of each landmark, and the relations."""
    records = list(trace.records.values())
    arrays: dict[str, Any] = {
        "trajectory": trace.trajectory,
        "since_key": np.reshape(trace.since_key, (-1, 3)),
        "ids": np.array(list(trace.records), dtype=np.int64),
        **{name: np.array([getattr(r, of) for r in records], dtype=np.int64) for name, of in _COUNTS.items()},
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


def read_arrays(file: Path, trace: Trace) -> None:
    """Add to the trace what `record.npz` holds; raises InputError for a file that is damaged."""
    with _loaded(file) as arrays:
        trajectory = _floats(arrays, "trajectory", (len(trace.key_stamps_ns), 3))
        trace.records = _records(arrays)
        trace.trajectory = trajectory
        trace.since_key = list(_floats(arrays, "since_key", (len(trace.stamps_ns), 3)))
        if "link_ends" in arrays:
            ends = arrays["link_ends"].astype(np.int64).reshape(-1, 2)
            count = len(ends)
            motions, covs = (
                _floats(arrays, "link_motions", (count, 3)),
                _floats(arrays, "link_covs", (count, 3, 3)),
            )
            if count and not 0 <= ends.min() <= ends.max() < len(trajectory):
                raise ValueError(f"link_ends {ends.min()} to {ends.max()} of {len(trajectory)} keyframes")
            trace.links = PoseLinks(ends, motions, covs)
        if "relation_stamps" in arrays:
            stamps = _floats(arrays, "relation_stamps", (-1, 2))
            trace.relations = Relations(stamps, _floats(arrays, "relation_poses", (len(stamps), 3)))


def read_records(file: Path) -> dict[LandmarkId, Record]:
    """What `record.npz` holds of each landmark; raises InputError for a file that is damaged."""
    with _loaded(file) as arrays:
        return _records(arrays)


def _records(arrays: dict[str, Any]) -> dict[LandmarkId, Record]:
    ids = _integers(arrays, "ids")
    n = len(ids)
    kinds, observations, first, last = (_integers(arrays, name, n).tolist() for name in _COUNTS)
    sigmas_m, extents = arrays["sigmas_m"].astype(np.float64), _floats(arrays, "extents", (n, 2, 2))
    if sigmas_m.shape != (n,):
        raise ValueError(f"sigmas_m of shape {sigmas_m.shape}")
    shapes = _floats(arrays, "shapes", (n, 5))
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
    """Set the trace's final estimate to that in `landmarks.npz`; raises InputError for a file that is damaged."""
    with _loaded(file) as arrays:
        ids = _integers(arrays, "ids")
        walls = _integers(arrays, "kinds", len(ids)) == Kind.WALL
        size = 3 + 2 * len(ids)
        mean, cov = _floats(arrays, "mean", (size,)), _floats(arrays, "covariance", (size, size))
        pose = Pose.from_array(mean[:3])
        trace.final = Estimate(pose, cov[:3, :3].copy(), ids, mean[3:].reshape(-1, 2), walls)
        trace.joint_cov = cov


def read_grid(file: Path, config: Config, radius_m: float) -> Grid:
    """The map that `grid.npz` holds; raises InputError for a file that is damaged."""
    with _loaded(file) as arrays:
        hits, passes = arrays["hits"].astype(np.int32), arrays["passes"].astype(np.int32)
        x, y = _floats(arrays, "origin", (2,)).tolist()
        return Grid.from_counts(config.grid, radius_m, (x, y), hits, passes, arrays["seen"].astype(np.bool_))


@contextlib.contextmanager
def _loaded(file: Path) -> Iterator[dict[str, Any]]:
    """The arrays of an NPZ file; whatever is wrong with them within the block is an InputError."""
    try:
        with np.load(file, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        yield arrays
    except InputError:
        raise
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror or 'damaged'})") from None
    except KeyError as error:
        raise InputError(file, f"found no array {error.args[0]!r}", "that of a run") from None
    except Exception as error:  # a damaged file makes its readers fail with undocumented exceptions
        raise InputError(file, f"found {reason_of(error)}", "the arrays of a run") from None


def _integers(arrays: dict[str, Any], name: str, count: int | None = None) -> Any:
    array = arrays[name]
    if array.dtype.kind != "i" or array.ndim != 1 or count not in (None, len(array)):
        raise ValueError(f"{name} of shape {array.shape} and type {array.dtype}")
    return array.astype(np.int64)


def _floats(arrays: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    return checked(name, arrays[name], shape)
