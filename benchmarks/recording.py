"""A run with everything kept that a figure of one of its moments needs, and what such figures share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sixthsense import plot
from sixthsense.config import Config
from sixthsense.features import Features, extract
from sixthsense.geometry import Array, Pose
from sixthsense.grid import Grid
from sixthsense.laser import Scan
from sixthsense.loop import run
from sixthsense.scene import Scene
from sixthsense.source import Tick
from sixthsense.trace import Trace


@dataclass
class Recording:
    """A run's key scans, one by one."""

    trace: Trace = field(init=False)
    scans: list[Scan] = field(default_factory=list)
    """per key scan"""
    plans: list[int] = field(default_factory=list)
    """per key scan: how many plans there are after it"""

    def on_tick(self, tick: Tick, trace: Trace) -> None:
        """Keep the scan, if it was a key scan."""
        if tick.scan is not None and len(trace.key_stamps_ns) > len(self.scans):
            self.scans.append(tick.scan)
            self.plans.append(len(trace.plans))

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


def features_of(scan: Scan, config: Config) -> Features:
    """A scan's features, with random numbers of their own."""
    return extract(scan, config.assumed, config.features, np.random.default_rng(0))


def record(config: Config) -> Recording:
    """Run `config` and keep its key scans."""
    recording = Recording()
    recording.trace = run(config, recording.on_tick)
    return recording


def scene_of(recording: Recording) -> Scene:
    assert recording.trace.scene is not None
    return recording.trace.scene


def draw_truth(ax: Any, scene: Scene, color: str = "#C8C8C8", near: Array | None = None, reach_m: float = 0.0) -> None:
    """Draw the true walls, all of them or what lies within `reach_m` of the (2,) point `near`."""
    plot.draw_segments(ax, scene.walls, colors=color, linewidths=1.4, zorder=0.5, label="walls, true")
    plot.label_plane(ax)
    low, high = scene.walls.reshape(-1, 2).min(axis=0) - 0.4, scene.walls.reshape(-1, 2).max(axis=0) + 0.4
    if near is not None:
        low, high = np.maximum(low, near - reach_m), np.minimum(high, near + reach_m)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def window(ax: Any, points: Array) -> None:
    """Look at (N, 2) points and a metre around them, in a window of 4 to 3."""
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    centre, half = 0.5 * (low + high), 0.5 * max(high[0] - low[0], (high[1] - low[1]) * 4 / 3)
    ax.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - 0.75 * half, centre[1] + 0.75 * half))


def panels(rows: int, columns: int, width: float, height: float) -> tuple[Any, list[Any]]:
    """A figure and its axes, row by row."""
    figure = plot.new_figure(width, height)
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


def legend(figure: Any, columns: int = 6) -> None:
    """One legend for all axes, below them."""
    entries = {
        label: handle for ax in figure.axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=columns, frameon=False)
