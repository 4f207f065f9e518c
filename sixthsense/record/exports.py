"""The files of a run for other programs: trajectories, landmarks, map, factor graph."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.covariance import root_information
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.record.trace import Trace
from sixthsense.record.writing import whole
from sixthsense.slam.front_end import PoseLinks

NO_LINKS = PoseLinks(np.zeros((0, 2), np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))
_MIN_SIGMA = 1e-6  # smallest sigma of a motion, m and rad: the information matrix must be finite


def write_exports(folder: Path, trace: Trace, metrics: Mapping[str, Any]) -> None:
    """Write what a finished run leaves for others: all files of its folder but the record, the verdict and figures."""
    write_tum(folder / "estimate.tum", trace.stamps_ns, np.array(trace.estimates))
    write_tum(folder / "smoothed.tum", trace.key_stamps_ns, trace.trajectory)
    if trace.truths:
        write_tum(folder / "truth.tum", trace.stamps_ns, np.array(trace.truths))
    write_landmarks(folder, trace)
    write_graph(folder, factor_graph(trace), links_of(trace))
    if trace.grid is not None:
        write_map(folder, trace.grid.occupancy(), trace.grid.origin, trace.config.grid.cell_m)
    if trace.outcome.startswith("explored"):
        write_places_left(folder / "places_left.csv", trace)
    with whole(folder / "metrics.json") as file:
        file.write_text(json.dumps(metrics, indent=1) + "\n", encoding="utf-8")


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
    """Write `landmarks.csv`: means, covariances and, of walls, the extent of what was seen."""
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


def known_part(
    occupancy: NDArray[np.int8], origin: tuple[float, float], cell_m: float
) -> tuple[NDArray[np.int8], tuple[float, float, float, float]] | None:
    """The part of (H, W) occupancy within the bounds of the known cells, and its extent: left, right, bottom, top, m.

    None without a known cell.
    """
    rows, cols = (np.flatnonzero(occupancy.max(axis=axis, initial=-1) >= 0) for axis in (1, 0))
    if len(rows) == 0:
        return None
    (r0, r1), (c0, c1) = ((int(cells[0]), int(cells[-1]) + 1) for cells in (rows, cols))
    x0, y0 = origin
    extent = x0 + c0 * cell_m, x0 + c1 * cell_m, y0 + r0 * cell_m, y0 + r1 * cell_m
    return occupancy[r0:r1, c0:c1], extent


def write_map(folder: Path, occupancy: NDArray[np.int8], origin: tuple[float, float], cell_m: float) -> None:
    """Write (H, W) occupancy (-1 unknown, 0 free, 100 occupied) as map_server's PGM and YAML.

    The image is cropped to the known cells.
    """
    import yaml
    from PIL import Image

    known = known_part(occupancy, origin, cell_m)
    if known is None:
        return
    part, (left, _, bottom, _) = known
    shades = np.select([part == 0, part == 100], [np.uint8(254), np.uint8(0)], np.uint8(205))
    with whole(folder / "map.pgm") as file:
        Image.fromarray(shades[::-1]).save(file)  # the first row of an image is the top of the map
    meta = {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": cell_m,
        "origin": [left, bottom, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    with whole(folder / "map.yaml") as file:
        file.write_text(yaml.safe_dump(meta, sort_keys=False), encoding="utf-8")


@dataclass(frozen=True, slots=True)
class FactorGraph:
    """Key poses, the odometry between them, and the observations of the final landmarks."""

    poses: Array
    """(K, 3) final pose at each keyframe, world frame"""
    landmark_ids: NDArray[np.int64]
    """(n,)"""
    landmarks: Array
    """(n, 2) final means, world frame, m"""
    motions: Array
    """(K - 1, 3) odometry from each key pose to the next, frame of the first of the two"""
    motion_covs: Array
    """(K - 1, 3, 3) their covariances, axes of the second frame"""
    observation_of: NDArray[np.int64]
    """(M, 2) index of the key pose, index of the landmark"""
    observations: Array
    """(M, 2) position in the robot's frame, m"""
    observation_covs: Array
    """(M, 2, 2) their covariances"""
    bearing_range: Array
    """(M, 2) the observations as bearing and range, the form used by the smoother; rad, m"""
    bearing_range_covs: Array
    """(M, 2, 2) their covariances"""
    wall_ids: NDArray[np.int64]
    """(w,)"""
    walls: Array
    """(w, 2) final means: alpha, rad, and d, m, world frame"""
    wall_observation_of: NDArray[np.int64]
    """(L, 2) index of the key pose, index of the wall"""
    wall_observations: Array
    """(L, 2) alpha and d in the robot's frame"""
    wall_observation_covs: Array
    """(L, 2, 2) their covariances"""


def factor_graph(trace: Trace) -> FactorGraph:
    """Build the factor graph of a finished run with any estimator, of the landmarks that this run has seen.

    Those of a prior map that it has not seen again are left out, as is what is known of the others by the prior map.
    """
    seen = np.isin(trace.final.ids, [i for association in trace.associations for i in association.observations])
    ids, landmarks, walls = trace.final.ids[seen], trace.final.landmarks[seen], trace.final.walls[seen]
    points, walls_seen = (_observations_of(trace, ids[kind].tolist()) for kind in (~walls, walls))
    polar = [observation.bearing_range() for _, _, observation in points]
    motions = trace.key_odometry[1:]
    return FactorGraph(
        trace.trajectory.copy(),
        ids[~walls],
        landmarks[~walls],
        np.array([m.motion.array() for m in motions]).reshape(-1, 3),
        np.array([_regularized_cov(m) for m in motions]).reshape(-1, 3, 3),
        *_columns(points),
        np.array([(bearing, distance) for bearing, distance, _ in polar]).reshape(-1, 2),
        np.array([cov for _, _, cov in polar]).reshape(-1, 2, 2),
        ids[walls],
        landmarks[walls],
        *_columns(walls_seen),
    )


def links_of(trace: Trace) -> PoseLinks:
    """The links by scan matching of a finished run, with covariances in the axes of the second frame."""
    found = trace.links or NO_LINKS
    links = [Odometry(Pose.from_array(motion), cov) for motion, cov in zip(found.motions, found.covs, strict=True)]
    return found._replace(covs=np.array([_regularized_cov(link) for link in links]).reshape(-1, 3, 3))


def _observations_of(trace: Trace, ids: list[LandmarkId]) -> list[tuple[int, int, Observation]]:
    """Observations of the landmarks `ids`: index of the keyframe, index of the landmark, observation."""
    column = {i: k for k, i in enumerate(ids)}
    return [
        (k, column[i], observation)
        for k, association in enumerate(trace.associations)
        for i, observation in association.observations.items()
        if i in column
    ]


def _columns(rows: list[tuple[int, int, Observation]]) -> tuple[NDArray[np.int64], Array, Array]:
    """(N, 2) indices of observations, (N, 2) what is seen, and (N, 2, 2) covariances."""
    return (
        np.array([(k, j) for k, j, _ in rows], dtype=np.int64).reshape(-1, 2),
        np.array([observation.z for _, _, observation in rows]).reshape(-1, 2),
        np.array([observation.cov for _, _, observation in rows]).reshape(-1, 2, 2),
    )


def _regularized_cov(odometry: Odometry) -> Array:
    return odometry.cov + _MIN_SIGMA**2 * np.eye(3)


def write_graph(folder: Path, graph: FactorGraph, links: PoseLinks = NO_LINKS) -> None:
    """Write `graph.g2o`, which GTSAM's `readG2o` reads, and `graph.npz`, which also contains the walls.

    In the g2o file a pose is VERTEX_SE2, odometry and links by scan matching EDGE_SE2 with
    their information matrices, a landmark VERTEX_XY, and an
    observation `BR pose landmark bearing range sigma_bearing sigma_range`, without the correlation of bearing and
    range. The first pose is the start of the run; the format has no tag for a prior. Poses are numbered first, then
    landmarks.
    """
    first = len(graph.poses)
    lines = [f"VERTEX_SE2 {k} {_row(pose)}" for k, pose in enumerate(graph.poses)]
    lines += [f"VERTEX_XY {first + j} {_row(xy)}" for j, xy in enumerate(graph.landmarks)]
    upper = np.triu_indices(3)
    steps = ((k, k + 1) for k in range(len(graph.motions)))
    edges = (*zip(steps, graph.motions, graph.motion_covs, strict=True), *zip(*links, strict=True))
    for (k, j), motion, cov in edges:
        lines.append(f"EDGE_SE2 {k} {j} {_row(motion)} {_row(_information(cov)[upper])}")
    rows = zip(graph.observation_of, graph.bearing_range, graph.bearing_range_covs, strict=True)
    for (k, j), polar, cov in rows:
        lines.append(f"BR {k} {first + j} {_row(polar)} {_row(np.sqrt(np.diag(cov)))}")
    with whole(folder / "graph.g2o") as file:
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with whole(folder / "graph.npz") as file:
        of_links = {f"link_{name}": values for name, values in links._asdict().items()}
        np.savez(file, **{name: getattr(graph, name) for name in FactorGraph.__slots__}, **of_links)


def _information(cov: Array) -> Array:
    root = root_information(cov)
    return root.T @ root


def _row(values: Array) -> str:
    return " ".join(f"{value:.17g}" for value in values)
