"""What the notebooks and pages draw of one scan, one filter step, a grid and a path, beside `sixthsense.figures`.

Each function draws on given axes. `record` runs a configuration and keeps its keyframes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.core.covariance import landmark_covariances
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick, seconds
from sixthsense.evaluation.metrics import true_landmarks
from sixthsense.figures.plot import (
    CHI2_95,
    CYCLE,
    ESTIMATE,
    LANDMARK,
    OBSERVATION,
    PLAN,
    SEEN,
    WALL,
    WALL_FOUND,
    draw_segments,
    ellipse,
    label_plane,
    shade,
    walls_found,
)
from sixthsense.loop.run import run
from sixthsense.record.trace import Trace
from sixthsense.simulation.scene import Scene
from sixthsense.slam.features import Features, extract
from sixthsense.slam.features.partition import Indices
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import NO_WALLS, Grid, Walls

_RETURN = "#666666"
_INFLATED = "#F6CFBF"


def draw_truth(ax: Any, scene: Scene, color: str = "#C8C8C8", near: Array | None = None, reach_m: float = 0.0) -> None:
    """Draw the true walls and show all of them, or a window of `reach_m` around the point `near` (2,)."""
    draw_segments(ax, scene.walls, colors=color, linewidths=1.4, zorder=0.5, label="true walls")
    label_plane(ax)
    low, high = scene.walls.reshape(-1, 2).min(axis=0) - 0.4, scene.walls.reshape(-1, 2).max(axis=0) + 0.4
    if near is not None:
        low, high = np.maximum(low, near - reach_m), np.minimum(high, near + reach_m)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def window(ax: Any, points: Array) -> None:
    """Show (N, 2) points with a margin of a metre in a window of aspect 4 to 3."""
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    centre, half = 0.5 * (low + high), 0.5 * max(high[0] - low[0], (high[1] - low[1]) * 4 / 3)
    ax.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - 0.75 * half, centre[1] + 0.75 * half))


def draw_seen(ax: Any, space: FreeSpace) -> None:
    """Colour the cells that a beam crossed or ended in: the sense grid."""
    shade(ax, space.seen, space.origin, space.cell_m, SEEN, 0.1)


def draw_hits(ax: Any, grid: Grid, cell_m: float) -> None:
    """Colour the obstacle cells of the hit grid, and in a paler colour the inflated cells."""
    space = grid.free_space()
    shade(ax, space.blocked, space.origin, space.cell_m, _INFLATED, 0.2)
    shade(ax, grid.obstacles, grid.origin, cell_m, LANDMARK, 0.3)


def draw_path(ax: Any, plan: Array, optimised: Array | None = None) -> None:
    """Draw a planned path (N, 2), and if given its shortcut (M, 2) with the current way point."""
    ax.plot(plan[:, 0], plan[:, 1], color=PLAN, linewidth=1.6, zorder=5, label="planned path")
    if optimised is not None:
        ax.plot(optimised[:, 0], optimised[:, 1], color=ESTIMATE, linewidth=1.6, zorder=6, label="path after shortcut")
        style = {"facecolors": "none", "edgecolors": OBSERVATION, "linewidths": 2.0, "zorder": 7}
        ax.scatter(*optimised[min(1, len(optimised) - 1)], s=90.0, label="current way point", **style)
    ax.scatter(*plan[-1], s=80.0, marker="*", color=PLAN, zorder=7, label="goal")
    label_plane(ax)


def draw_robot(ax: Any, pose: Pose, radius_m: float) -> None:
    """Draw the robot as a disc with a line for its heading."""
    from matplotlib.patches import Circle

    ax.add_patch(Circle((pose.x, pose.y), radius_m, facecolor="white", edgecolor=WALL, linewidth=1.2, zorder=8))
    nose = pose.position + radius_m * np.array([math.cos(pose.theta), math.sin(pose.theta)])
    ax.plot([pose.x, nose[0]], [pose.y, nose[1]], color=WALL, linewidth=1.2, zorder=9)


def draw_region(ax: Any, space: FreeSpace, cells: NDArray[np.bool_]) -> None:
    """Colour a mask (H, W) of cells, such as the reachable ones, and the blocked cells."""
    shade(ax, cells, space.origin, space.cell_m, SEEN, 0.1)
    shade(ax, space.blocked, space.origin, space.cell_m, _INFLATED, 0.2)


def draw_way(ax: Any, poses: Array, color: str = ESTIMATE, label: str | None = None, width: float = 0.9) -> None:
    """Draw the path along positions (N, 2) or poses (N, 3), world frame, metres."""
    ax.plot(poses[:, 0], poses[:, 1], color=color, linewidth=width, label=label)
    label_plane(ax)


def draw_walls_at(ax: Any, trace: Trace, poses: Array) -> None:
    """Draw the detected walls of the keyframes, placed by `poses` (S, 3), one for each scan."""
    # The first scan with a given last keyframe is that keyframe.
    first = np.unique(trace.last_key, return_index=True)[1]
    style: dict[str, Any] = {"colors": WALL, "linewidths": 0.5, "alpha": 0.5, "zorder": 1}
    draw_segments(ax, walls_found(trace, poses[first]), **style)
    label_plane(ax)


def _points(pose: Pose, scan: Scan) -> Array:
    """(N, 2) end points of the beams, world frame; NaN for a beam without a return."""
    points = np.where(np.isfinite(scan.ranges)[:, None], scan.points_robot, np.nan)
    return pose @ points


def draw_beams(ax: Any, pose: Pose, scan: Scan, color: str = LANDMARK) -> None:
    """Draw the beams of a scan taken at `pose`; those without a return up to the maximum range."""
    lengths = np.where(np.isfinite(scan.ranges), scan.ranges, scan.max_range).astype(np.float64)
    T_world_laser = pose @ scan.T_robot_laser
    bearings = scan.bearings
    ends = T_world_laser @ np.stack([lengths * np.cos(bearings), lengths * np.sin(bearings)], axis=1)
    starts = np.broadcast_to(T_world_laser.position, ends.shape)
    style = {"colors": color, "linewidths": 0.3, "alpha": 0.6, "zorder": 1}
    draw_segments(ax, np.stack([starts, ends], axis=1), label="beams", **style)
    label_plane(ax)


def draw_returns(ax: Any, pose: Pose, scan: Scan, color: str = _RETURN, size: float = 4.0) -> None:
    """Draw the returns of a scan taken at `pose`."""
    points = _points(pose, scan)
    ax.scatter(points[:, 0], points[:, 1], s=size, color=color, linewidths=0.0, zorder=3, label="laser returns")
    label_plane(ax)


def draw_partitions(ax: Any, pose: Pose, scan: Scan, parts: Sequence[Indices], least: int = 1) -> None:
    """Draw the returns of each partition in its own colour, and all others in grey.

    Partitions with fewer than `least` returns are ignored.
    """
    points = _points(pose, scan)
    draw_returns(ax, pose, scan, color="#BBBBBB", size=3.0)
    for k, part in enumerate(part for part in parts if len(part) >= least):
        ax.scatter(*points[part].T, s=8.0, color=CYCLE[k % len(CYCLE)], linewidths=0.0, zorder=4)


def draw_detections(ax: Any, pose: Pose, features: Features, enlarged: float = 0.0) -> None:
    """Draw the walls (pink) and landmarks (cyan circles) detected in one scan from `pose`.

    With `enlarged` above 0, draw the 95 % ellipses of the observations, enlarged by this factor.
    """
    draw_segments(ax, pose @ features.walls, colors=WALL_FOUND, linewidths=2.0, zorder=4, label="detected walls")
    observations = [observation for observation in features.observations if not observation.is_wall]
    if observations:
        points = pose @ np.array([observation.z for observation in observations])
        style = {"facecolors": "none", "edgecolors": OBSERVATION, "linewidths": 1.6, "zorder": 5}
        ax.scatter(points[:, 0], points[:, 1], s=50.0, label="detected landmarks", **style)
        for k, observation in enumerate(observations if enlarged else ()):
            outline = pose @ ellipse(observation.z, enlarged**2 * observation.cov)
            label = f"95 %, enlarged {enlarged:g} times" if k == 0 else None
            ax.plot(outline[:, 0], outline[:, 1], color=LANDMARK, linewidth=0.8, zorder=6, label=label)
    label_plane(ax)


def draw_state(
    ax: Any, mean: Array, cov: Array, color: str = ESTIMATE, label: str | None = None, enlarged: float = 1.0
) -> None:
    """Draw the 95 % ellipses of the position (filled) and of all point landmarks, `enlarged` by a factor.

    The state is one Gaussian: `mean` (3 + 2n,) of x, y, theta and the n points, world frame, and its covariance.
    """
    from matplotlib.collections import PolyCollection

    points = mean[3:].reshape(-1, 2)
    outlines = [ellipse(at, enlarged**2 * own) for at, own in zip(points, landmark_covariances(cov), strict=True)]
    own = ellipse(mean[:2], enlarged**2 * cov[:2, :2])
    ax.fill(own[:, 0], own[:, 1], color=color, alpha=0.25, linewidth=0.0, zorder=9)
    ax.plot(own[:, 0], own[:, 1], color=color, linewidth=1.2, zorder=9.5, label=label)
    ax.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=color, linewidths=1.2, zorder=6))
    ax.scatter(points[:, 0], points[:, 1], s=5.0, color=color, linewidths=0.0, zorder=6)
    label_plane(ax)


def draw_innovations(ax: Any, pose: Pose, z: Array, predicted: Array, covs: Array, gate: float = CHI2_95) -> None:
    """Draw predicted observations with the gates of their innovations, and the actual observations.

    `z` (m, 2) and `predicted` (k, 2) in the robot's frame at `pose`; `covs` (k, 2, 2); a gate is the ellipse at the
    squared Mahalanobis distance `gate`.
    """
    for k, (mean, cov) in enumerate(zip(predicted, covs, strict=True)):
        outline = pose @ ellipse(mean, gate / CHI2_95 * cov)
        ax.plot(*outline.T, color=ESTIMATE, linewidth=1.1, zorder=5, label="gate" if k == 0 else None)
    ax.scatter(*(pose @ predicted).T, s=12.0, color=ESTIMATE, zorder=5, label="predicted observation")
    style: dict[str, Any] = {"facecolors": "none", "edgecolors": OBSERVATION, "linewidths": 1.8}
    ax.scatter(*(pose @ z).T, s=60.0, zorder=6, label="observation", **style)
    label_plane(ax)


def draw_correlation(ax: Any, cov: Array, title: str = "") -> None:
    """Draw the correlations of a joint covariance (3 + 2k, 3 + 2k): the pose's three rows first, then the landmarks."""
    from matplotlib import colormaps

    sigma = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    colors = colormaps["RdBu_r"].resampled(15)
    image = ax.imshow(cov / np.outer(sigma, sigma), cmap=colors, vmin=-1.0, vmax=1.0, interpolation="nearest")
    ax.figure.colorbar(image, ax=ax, shrink=0.8, label="correlation [1]")
    for lines in (ax.axhline, ax.axvline):
        lines(2.5, color="black", linewidth=0.6)
    ax.set_xticks([1.0, 0.5 * (len(cov) + 2.0)], ["pose", "landmarks"])
    ax.set_yticks([1.0, 0.5 * (len(cov) + 2.0)], ["pose", "landmarks"])
    ax.set_title(title)


def strays_m(pose: Pose, features: Features, scene: Scene) -> float:
    """Largest distance, metres, of a detected wall from the true walls, for a scan from the true `pose`."""
    along = np.linspace(0.0, 1.0, 21)[:, None]
    points = [a + along * (b - a) for a, b in pose @ features.walls]
    return max((float(point_segment_distance(p, scene.walls).min()) for part in points for p in part), default=0.0)


def draw_change(ax: Any, pose: Pose, features: Features, usual: Features) -> None:
    """Draw the features of a scan at `pose` over those of the `usual` settings (crosses, dotted)."""
    draw_segments(ax, pose @ usual.walls, colors=LANDMARK, linewidths=3.0, linestyles=":", label="walls by default")
    points = pose @ np.array([seen.z for seen in usual.observations if not seen.is_wall]).reshape(-1, 2)
    ax.scatter(*points.T, s=45.0, marker="x", color=LANDMARK, linewidths=1.6, label="landmarks by default")
    draw_detections(ax, pose, features)


@dataclass
class Recording:
    """The trace of a run with its keyframes."""

    trace: Trace = field(init=False)
    """trace of the whole run"""
    scans: list[Scan] = field(default_factory=list)
    """the keyframes"""
    plans: list[int] = field(default_factory=list)
    """for each keyframe, the number of plans after it"""

    def on_tick(self, tick: Tick, trace: Trace) -> None:
        """Keep the scan if it is a keyframe."""
        if tick.scan is not None and len(trace.key_stamps_ns) > len(self.scans):
            self.scans.append(tick.scan)
            self.plans.append(len(trace.plans))

    @property
    def scene(self) -> Scene:
        """The scene of the run."""
        assert self.trace.scene is not None
        return self.trace.scene

    def pose(self, k: int) -> Pose:
        """The estimated pose at keyframe k, after its update."""
        return self.trace.key_estimates[k].pose

    def time_s(self, k: int) -> float:
        """Time of keyframe k since the first one, seconds."""
        return seconds(self.trace.key_stamps_ns[k] - self.trace.key_stamps_ns[0])

    def grid(self, k: int) -> Grid:
        """The grid after keyframe k, rebuilt from the keyframes up to it."""
        grid = Grid(self.trace.config.grid, self.trace.radius_m)
        for i in range(k + 1):
            grid.add(self.pose(i), self.scans[i], Walls(self.trace.walls_found[i], NO_WALLS.gaps))
        return grid

    def features(self, k: int) -> Features:
        """The features of keyframe k."""
        return features_of(self.scans[k], self.trace.config)

    def way(self, k: int) -> Array:
        """(M, 2) estimated positions up to keyframe k."""
        return np.array(self.trace.estimates)[: 1 + self.trace.last_key.index(k), :2]


@dataclass(frozen=True, slots=True)
class Culled:
    """A landmark that was removed from the state."""

    born: int
    """keyframe at which it was initialised"""
    gone: int
    """first keyframe without it"""
    off_m: float
    """distance of its last position from the nearest true corner or wall end"""
    position: Array
    """(2,) last position, world frame"""


def worst_culled(run: Recording) -> Culled:
    """Of the landmarks that a run of points has forgotten, the one farthest from any true one.

    Raises ValueError for a run without removed landmarks.
    """
    true = true_landmarks(run.scene.walls)
    seen: dict[int, tuple[int, Array]] = {}
    found: list[Culled] = []
    for k, estimate in enumerate(run.trace.key_estimates):
        now = dict(zip(estimate.ids.tolist(), estimate.landmarks, strict=True))
        for i in set(seen) - set(now):
            born, where = seen.pop(i)
            found.append(Culled(born, k, float(np.linalg.norm(true - where, axis=1).min()), where))
        for i, where in now.items():
            seen[i] = seen.get(i, (k, where))[0], where
    if not found:
        raise ValueError("run: found no removed landmark, allowed: a run with one")
    return max(found, key=lambda one: one.off_m)


def features_of(scan: Scan, config: Config) -> Features:
    """The features of a scan, extracted with a fixed seed."""
    return extract(scan, config.assumed, config.features)


def record(config: Config) -> Recording:
    """Run a configuration and keep its keyframes."""
    recording = Recording()
    recording.trace = run(config, recording.on_tick)
    return recording
