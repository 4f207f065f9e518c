"""The factor graph of a run for GTSAM and g2o: measurements between key poses and landmarks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

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
    return odometry.cov_after() + _MIN_SIGMA**2 * np.eye(3)


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
