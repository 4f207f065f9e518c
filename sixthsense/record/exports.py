"""The files of a run for other programs: trajectories, landmarks, map, factor graph, and a ROS 2 bag."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.covariance import landmark_covariances, root_information
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Observation
from sixthsense.core.source import Tick
from sixthsense.logs.runfolder import FILE, Message, paths_of, read_messages, ticks_of
from sixthsense.record.messages import LASER, ROBOT, Messages
from sixthsense.record.trace import Trace
from sixthsense.record.writing import whole
from sixthsense.slam.front_end import PoseLinks

NAMES = (
    "metrics.json", "estimate.tum", "smoothed.tum", "truth.tum", "landmarks.csv", "map.pgm", "map.yaml", "map.png",
    "bag", "graph.g2o", "graph.npz", "trajectory.csv", "places_left.csv",
)  # fmt: skip
"""what a run or `sixthsense export` writes beside record and configuration"""
NO_LINKS = PoseLinks(np.zeros((0, 2), np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))
_MIN_SIGMA = 1e-6  # smallest sigma of a motion, m and rad: the information matrix must be finite


def write_files(folder: Path, trace: Trace, metrics: Mapping[str, Any]) -> None:
    """Write what a finished run leaves beside its record: metrics, trajectories, landmarks and map."""
    write_trajectories(folder, trace)
    write_landmarks(folder, trace)
    if trace.grid is not None:
        write_map(folder, trace.grid.occupancy(), trace.grid.origin, trace.config.grid.cell_m)
    with whole(folder / "metrics.json") as file:
        file.write_text(json.dumps(metrics, indent=1) + "\n", encoding="utf-8")


def write_trajectories(folder: Path, trace: Trace) -> list[Path]:
    """Write `estimate.tum`, `smoothed.tum`, and `truth.tum` where there is truth; returns the files."""
    poses = {
        "estimate.tum": (trace.stamps_ns, np.array(trace.estimates)),
        "smoothed.tum": (trace.key_stamps_ns, trace.trajectory),
        "truth.tum": (trace.stamps_ns, np.array(trace.truths)),
    }
    files = [folder / name for name, (_, rows) in poses.items() if name != "truth.tum" or len(rows)]
    for file in files:
        write_tum(file, *poses[file.name])
    return files


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


_POINT = ("x", "y", "cov_xx", "cov_xy", "cov_yy")
_WALL = ("alpha", "d", "cov_alpha_alpha", "cov_alpha_d", "cov_d_d")
_EXTENT = ("from_x", "from_y", "to_x", "to_y")
LANDMARK_COLUMNS = ("id", "kind", *_POINT, *_WALL, "observations", *_EXTENT)


def landmark_rows(trace: Trace) -> Iterator[dict[str, Any]]:
    """A row for each landmark of the final map: mean and covariance and, of a wall, the extent of what was seen."""
    estimate, covs = trace.final, landmark_covariances(trace.joint_cov)
    for k, i in enumerate(estimate.ids.tolist()):
        record, names = trace.records[i], _WALL if estimate.walls[k] else _POINT
        values = [*estimate.landmarks[k].tolist(), *covs[k][np.triu_indices(2)].tolist()]
        row = {"id": i, "kind": record.kind.name.lower(), "observations": record.observations}
        row |= zip(names, values, strict=True)
        yield row | dict(zip(_EXTENT, record.extent.ravel().tolist() if estimate.walls[k] else (), strict=False))


def write_landmarks(folder: Path, trace: Trace) -> None:
    """Write the rows of the landmarks as `landmarks.csv`, empty where a kind has no such column."""
    with whole(folder / "landmarks.csv") as file, file.open("w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, LANDMARK_COLUMNS)
        writer.writeheader()
        writer.writerows(landmark_rows(trace))


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
    from PIL import Image

    known = known_part(occupancy, origin, cell_m)
    if known is None:
        return
    part, (left, _, bottom, _) = known
    shades = np.select([part == 0, part == 100], [np.uint8(254), np.uint8(0)], np.uint8(205))
    with whole(folder / "map.pgm") as file:
        Image.fromarray(shades[::-1]).save(file)  # the first row of an image is the top of the map
    text = f"image: map.pgm\nmode: trinary\nresolution: {cell_m}\norigin: [{left}, {bottom}, 0.0]\n"
    with whole(folder / "map.yaml") as file:
        file.write_text(f"{text}negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n", encoding="utf-8")


def graph_arrays(trace: Trace) -> dict[str, NDArray[Any]]:
    """The factor graph of a finished run with any estimator, of the landmarks that this run has seen, as arrays.

    `poses` (K, 3) final key poses; `motions` (K - 1, 3) odometry from each to the next, frame of the first, with
    `motion_covs` in the axes of the second; `link_ends` (m, 2), `link_motions` and `link_covs` the same by scan
    matching. `landmark_ids` (n,) and `landmarks` (n, 2) of points, m; `observation_of` (M, 2) key pose and landmark of
    each observation, `bearing_range` (M, 2), rad and m, and `bearing_range_covs`. `wall_ids` (w,) and `walls` (w, 2),
    alpha and d, with `wall_observation_of` (L, 2), `wall_observations` in the robot's frame and
    `wall_observation_covs`. What a prior map knows, and landmarks of it that were not seen again, are left out.
    """
    seen = np.isin(trace.final.ids, [i for association in trace.associations for i in association.observations])
    ids, landmarks, is_wall = trace.final.ids[seen], trace.final.landmarks[seen], trace.final.walls[seen]
    motions = trace.key_odometry[1:]
    points, walls = (list(_observations(trace, ids[kind].tolist())) for kind in (~is_wall, is_wall))
    polar = [observation.bearing_range() for _, _, observation in points]
    found: dict[str, NDArray[Any]] = {
        "poses": trace.trajectory,
        "motions": _rows([motion.motion.array() for motion in motions], 3),
        "motion_covs": _regular(_rows([motion.cov for motion in motions], 3, 3)),
        "landmark_ids": ids[~is_wall],
        "landmarks": landmarks[~is_wall],
        "observation_of": _rows([(k, j) for k, j, _ in points], 2).astype(np.int64),
        "bearing_range": _rows([(bearing, distance) for bearing, distance, _ in polar], 2),
        "bearing_range_covs": _rows([cov for _, _, cov in polar], 2, 2),
        "wall_ids": ids[is_wall],
        "walls": landmarks[is_wall],
        "wall_observation_of": _rows([(k, j) for k, j, _ in walls], 2).astype(np.int64),
        "wall_observations": _rows([observation.z for _, _, observation in walls], 2),
        "wall_observation_covs": _rows([observation.cov for _, _, observation in walls], 2, 2),
    }
    ends, steps, covs = NO_LINKS if trace.links is None else trace.links
    return found | {"link_ends": ends, "link_motions": steps, "link_covs": _regular(covs)}


def _observations(trace: Trace, ids: list[int]) -> Iterator[tuple[int, int, Observation]]:
    """Observations of the landmarks `ids`: index of the keyframe, index of the landmark, observation."""
    column = {i: k for k, i in enumerate(ids)}
    for k, association in enumerate(trace.associations):
        yield from ((k, column[i], seen) for i, seen in association.observations.items() if i in column)


def _rows(values: list[Any], *shape: int) -> Array:
    return np.array(values, dtype=np.float64).reshape(-1, *shape)


def _regular(covs: Array) -> Array:
    return covs + _MIN_SIGMA**2 * np.eye(3)


def write_graph(file: Path, trace: Trace) -> None:
    """Write the arrays of `graph_arrays` as NPZ."""
    with whole(file) as unfinished:
        np.savez(unfinished, **graph_arrays(trace))  # type: ignore[arg-type]


def write_g2o(file: Path, trace: Trace) -> None:
    """Write the factor graph as g2o, which GTSAM's `readG2o` reads.

    A pose is VERTEX_SE2, odometry and links by scan matching EDGE_SE2 with their information matrices, a landmark
    VERTEX_XY, and an observation `BR pose landmark bearing range sigma_bearing sigma_range`, without the correlation of
    bearing and range. The first pose is the start of the run; the format has no tag for a prior or a wall. Poses are
    numbered first, then landmarks.
    """
    graph = graph_arrays(trace)
    first = len(graph["poses"])
    lines = [f"VERTEX_SE2 {k} {_row(pose)}" for k, pose in enumerate(graph["poses"])]
    lines += [f"VERTEX_XY {first + j} {_row(xy)}" for j, xy in enumerate(graph["landmarks"])]
    upper = np.triu_indices(3)
    steps = [(k, k + 1) for k in range(len(graph["motions"]))]
    edges = (
        *zip(steps, graph["motions"], graph["motion_covs"], strict=True),
        *zip(graph["link_ends"], graph["link_motions"], graph["link_covs"], strict=True),
    )
    for (k, j), motion, cov in edges:
        lines.append(f"EDGE_SE2 {k} {j} {_row(motion)} {_row(_information(cov)[upper])}")
    rows = zip(graph["observation_of"], graph["bearing_range"], graph["bearing_range_covs"], strict=True)
    for (k, j), polar, cov in rows:
        lines.append(f"BR {k} {first + j} {_row(polar)} {_row(np.sqrt(np.diag(cov)))}")
    with whole(file) as unfinished:
        unfinished.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _information(cov: Array) -> Array:
    root = root_information(cov)
    return root.T @ root


def _row(values: Array) -> str:
    return " ".join(f"{value:.17g}" for value in values)


TOPICS = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
    "/truth": "geometry_msgs/msg/PoseStamped",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/estimate": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/plan": "nav_msgs/msg/Path",
    "/tour": "nav_msgs/msg/Path",
}
"""topics and their types, in the order of one tick"""

Stamped = tuple[int, str, Any]
"""record time, ns, topic and message"""


def write_bag(out: Path, run: Path, trace: Trace) -> None:
    """Write the record in the folder `run` as a bag, a new folder `out`; `trace` is that of the record.

    The record time of a message is the stamp of its tick. A scan's header has the stamp of the log, or without one the
    stamp of its first beam, as in ROS.
    """
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
    from rosbags.rosbag2 import StoragePlugin, Writer

    make, (recorded, _) = Messages(), read_messages(run / FILE)
    forever = QosTime(9_223_372_036, 854_775_807)
    # Transient local: subscribers that come later receive the mount, too.
    latched = Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
        forever, forever, QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip
    with Writer(out, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        channels = {
            topic: bag.add_connection(
                topic, kind, typestore=make.store, offered_qos_profiles=[latched] if topic == "/tf_static" else []
            )
            for topic, kind in TOPICS.items()
        }
        for stamp_ns, topic, message in _messages(make, trace, recorded):
            bag.write(channels[topic], stamp_ns, make.serialized(message, TOPICS[topic]))


def _messages(make: Messages, trace: Trace, recorded: Sequence[Message]) -> list[Stamped]:
    """All messages, in the order of their record times."""
    keys, mount = zip(trace.key_stamps_ns, trace.key_estimates, strict=True), Pose(*trace.config.laser.mount)
    ticks = ticks_of(recorded, mount)
    found: list[Stamped] = [(ticks[0].stamp_ns, "/tf_static", make.transform(ticks[0].stamp_ns, ROBOT, LASER, mount))]
    found += (message for tick in ticks for message in _of_tick(make, tick))
    found += ((stamp_ns, "/estimate", make.estimate(stamp_ns, one.pose, one.pose_cov)) for stamp_ns, one in keys)
    for name in ("plan", "tour"):
        found += ((stamp_ns, f"/{name}", make.path(stamp_ns, path)) for stamp_ns, path in paths_of(recorded, name))
    return sorted(found, key=lambda message: message[0])


def _of_tick(make: Messages, tick: Tick) -> Iterator[Stamped]:
    stamp_ns, scan = tick.stamp_ns, tick.scan
    yield stamp_ns, "/odom", make.odometry(stamp_ns, tick.odometry)
    if tick.truth is not None:
        yield stamp_ns, "/truth", make.pose_stamped(stamp_ns, tick.truth)
    if scan is not None:
        header_ns = stamp_ns if tick.log_stamp_s is None else round(Fraction(tick.log_stamp_s) * 1_000_000_000)
        yield stamp_ns, "/scan", make.scan(header_ns, scan)
