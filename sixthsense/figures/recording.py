"""A run with everything kept that a figure of one of its moments needs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.evaluation.metrics import true_landmarks
from sixthsense.loop import run
from sixthsense.record.trace import Trace
from sixthsense.slam.features import Features, extract
from sixthsense.slam.mapping.grid import Grid
from sixthsense.sources.scene import Scene


@dataclass
class Recording:
    """A run's key scans, one by one."""

    trace: Trace = field(init=False)
    """of the whole run"""
    scans: list[Scan] = field(default_factory=list)
    """per key scan"""
    plans: list[int] = field(default_factory=list)
    """per key scan: how many plans there are after it"""

    def on_tick(self, tick: Tick, trace: Trace) -> None:
        """Keep the scan, if it was a key scan."""
        if tick.scan is not None and len(trace.key_stamps_ns) > len(self.scans):
            self.scans.append(tick.scan)
            self.plans.append(len(trace.plans))

    @property
    def scene(self) -> Scene:
        """Where the run was."""
        assert self.trace.scene is not None
        return self.trace.scene

    def pose(self, k: int) -> Pose:
        """Where the robot believed to be at key scan k, after its update."""
        return self.trace.key_estimates[k].pose

    def time_s(self, k: int) -> float:
        """Of key scan k, since the start."""
        return 1e-9 * (self.trace.key_stamps_ns[k] - self.trace.key_stamps_ns[0])

    def grid(self, k: int) -> Grid:
        """The map after key scan k, built anew from the scans up to it."""
        grid = Grid(self.trace.config.grid, self.trace.radius_m)
        for i in range(k + 1):
            grid.add(self.pose(i), self.scans[i], self.trace.walls_found[i])
        return grid

    def features(self, k: int) -> Features:
        """What the scan of key scan k shows."""
        return features_of(self.scans[k], self.trace.config)

    def way(self, k: int) -> Array:
        """(M, 2) estimated positions up to key scan k."""
        return np.array(self.trace.estimates)[: 1 + self.trace.last_key.index(k), :2]


@dataclass(frozen=True, slots=True)
class Culled:
    """A landmark that was in the state for a while."""

    born: int
    """key scan of its birth"""
    gone: int
    """first key scan without it"""
    off_m: float
    """from where it was last to the nearest true corner or end of a wall"""
    position: Array
    """(2,) where it was last, world frame"""


def worst_culled(run: Recording) -> Culled:
    """Of the landmarks that a run of points has forgotten, the one farthest from any true one.

    Raises ValueError for a run that forgot none.
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
        raise ValueError("run: found no landmark that was culled, allowed: a run with one")
    return max(found, key=lambda one: one.off_m)


def features_of(scan: Scan, config: Config) -> Features:
    """A scan's features, with random numbers of their own."""
    return extract(scan, config.assumed, config.features, np.random.default_rng(0))


def record(config: Config) -> Recording:
    """Run `config` and keep its key scans."""
    recording = Recording()
    recording.trace = run(config, recording.on_tick)
    return recording
