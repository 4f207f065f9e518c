"""A run with its keyframes, for figures of single moments."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick, seconds
from sixthsense.evaluation.metrics import true_landmarks
from sixthsense.loop.run import run
from sixthsense.record.trace import Trace
from sixthsense.simulation.scene import Scene
from sixthsense.slam.features import Features, extract
from sixthsense.slam.mapping.grid import Grid


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
            grid.add(self.pose(i), self.scans[i], self.trace.walls_found[i])
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
    return extract(scan, config.assumed, config.features, np.random.default_rng(0))


def record(config: Config) -> Recording:
    """Run a configuration and keep its keyframes."""
    recording = Recording()
    recording.trace = run(config, recording.on_tick)
    return recording
