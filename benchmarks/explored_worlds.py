"""Explorations of shipped scenes and of maps that others drew: what was seen, how honest the pose was, and the travel.

    python benchmarks/explored_worlds.py --seeds 30 --jobs 2                              # shipped scenes
    SIXTHSENSE_DATA=FOLDER python benchmarks/explored_worlds.py --maps --seeds 1          # market and the plans
    python benchmarks/explored_worlds.py --world PLAN.yaml X Y THETA --seeds 1

The travel is compared with that of a robot that always knows where it is and what is solid around what it has seen,
and drives to the nearest frontier by the shortest path (Yamauchi, "A frontier-based approach for autonomous
exploration", CIRA 1997), with the same laser's range, the same clearance and the same coverage, and home at the end. It
takes a full scan after every keyframe's distance and chooses again when it has arrived or seen what it went for.
"""

from __future__ import annotations

import dataclasses
import json
import math
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from harness import Figures, arguments, check_at_least, finish, pooled, run
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt
from worlds import maps_at_hand, occupied, world

from sixthsense.config import Config, preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array
from sixthsense.evaluation.coverage import visible_area
from sixthsense.navigation.gridsearch import geodesic_distances, shortest_path
from sixthsense.navigation.viewpoints import Viewpoints
from sixthsense.navigation.visibility import mark_visible
from sixthsense.running.warmup import warm_up
from sixthsense.sources.mission import mission
from sixthsense.sources.scene import load_scene

SHIPPED = ("rectangle", "block", "apartment", "office", "loop")
# Where an exploration of a plan begins; of another plan where its first tour does.
STARTS: dict[str, tuple[float, ...]] = {
    "Freiburg101_scan": (17.675, 23.125, 0.0),
    "Freiburg79_scan": (7.875, 9.675, 0.0),
    "building_31": (-7.575, 4.675, 0.0),
    "lab_ipa": (8.725, 17.125, 0.0),
    "stata": (-20.15, 9.84, 0.0),
    "willow": (28.85, 26.65, 0.0),
}
CELL_M = 0.1
SLOW_MS = 150.0
_LEAST_M = 1.0  # travel that can be compared
Row = dict[str, Any]
Mask = NDArray[np.bool_]


class Place(NamedTuple):
    """A scene, and where the robot begins; no start: the scene's."""

    scene: str
    start: tuple[float, ...] | None = None


def nearest_frontier_travel(config: Config, share: float) -> float:
    """Length, m, of a way by nearest frontiers that shows a share of the visible area, and home; NaN if none does."""
    scene = load_scene(config.scene, config.map_unknown)
    start, _, radius_m = mission(scene, config)
    region = config.region or scene.region
    area = visible_area(scene.walls, region, (start.x, start.y), radius_m, config.laser.max_range, CELL_M)
    solid = occupied(scene.walls, np.array(area.origin), area.cell_m, area.mask.shape)
    passable = distance_transform_edt(~solid) * area.cell_m > radius_m + config.grid.clearance_m
    home = int((start.y - area.origin[1]) / area.cell_m), int((start.x - area.origin[0]) / area.cell_m)
    passable[home] = True
    view = _View(area.mask, solid, config.laser.max_range / area.cell_m)
    here, travelled, stride = home, 0.0, config.keyframes.distance_m / area.cell_m
    view.look(here)
    while view.share < share:
        known = passable & (view.seen | ~area.mask)
        known[here] = True
        lengths = geodesic_distances(known, ~known, *here)
        goal, wanted = view.nearest(lengths)
        if goal is None:
            return math.nan
        cells, _, _ = shortest_path(~known, here, goal)
        steps = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(cells, axis=0).T))])
        looks = np.unique(np.append(np.searchsorted(steps, np.arange(stride, steps[-1], stride)), len(cells) - 1))
        for k in looks:
            view.look((int(cells[k, 0]), int(cells[k, 1])))
            if view.seen[wanted] or view.share >= share:
                break
        travelled += float(steps[k])
        here = int(cells[k, 0]), int(cells[k, 1])
        if k == len(cells) - 1 and not view.seen[wanted]:
            view.given_up[wanted] = True
    return (travelled + float(geodesic_distances(passable, ~passable, *here)[home])) * area.cell_m


class _View:
    """What has been seen of a known map."""

    def __init__(self, area: Mask, solid: Mask, reach: float) -> None:
        self.seen = np.zeros_like(area)
        self.given_up = np.zeros_like(area)
        """cells that were not seen from where they should be visible"""
        self._area, self._solid, self._reach = np.array(area), solid, reach
        self._cells = max(np.count_nonzero(area), 1)

    @property
    def share(self) -> float:
        return float(np.count_nonzero(self.seen) / self._cells)

    def look(self, cell: tuple[int, int]) -> None:
        mark_visible(self.seen, self._solid, self._area, *cell, self._reach)

    def nearest(self, lengths: Array) -> tuple[tuple[int, int] | None, tuple[int, int]]:
        """The cell to drive to, and the unseen cell beside seen ones that is visible from there."""
        frontier = np.argwhere(self._area & ~self.seen & ~self.given_up & binary_dilation(self.seen, np.ones((3, 3))))
        reachable = np.isfinite(lengths)
        viewpoints = Viewpoints(reachable, self._solid, 0.95 * self._reach)
        away, places = distance_transform_edt(~reachable, return_indices=True)
        if len(frontier):
            rows, cols = frontier.T
            costs = lengths[places[0, rows, cols], places[1, rows, cols]] + away[rows, cols]
            for row, col in frontier[np.argsort(costs, kind="stable")].tolist():
                found = viewpoints.nearest((row, col))
                if found is not None:
                    return found, (row, col)
                self.given_up[row, col] = True
        return None, (0, 0)


def make_row(config: Config) -> Row:
    """Explore, and compare the travel."""
    began = time.process_time()
    found = run(config)
    spent_s = time.process_time() - began
    metrics, ms = found.metrics, found.trace.stopwatch.keyframe_ms()[1:]
    share = metrics.get("coverage", math.nan)
    reference = nearest_frontier_travel(config, min(share, 0.999)) if share == share else math.nan
    row = {
        "world": Path(config.scene).stem, "seed": config.seed, "outcome": metrics["outcome"],
        "collisions": metrics.get("collisions", math.nan), "coverage": share,
        "left_m2": metrics.get("area_left_m2", math.nan), "nees": metrics.get("pose_nees_world_mean", math.nan),
        "ate_m": metrics.get("ate_rmse_m", math.nan), "home_m": metrics.get("home_error_m", math.nan),
        "travel_m": metrics["path_length_m"], "reference_m": reference, "sim_s": metrics["sim_time_s"],
        "processor_s": spent_s, "keyframe_ms_p99": float(np.percentile(ms, 99)) if len(ms) else math.nan,
        "slow": int(np.count_nonzero(ms > SLOW_MS)),
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }  # fmt: skip
    print(json.dumps(row), file=sys.stderr, flush=True)
    return row


def over_reference(found: Sequence[Row]) -> list[float]:
    """The travel of each run over that of nearest frontiers, where there is any to speak of."""
    return [row["travel_m"] / row["reference_m"] for row in found if row["reference_m"] > _LEAST_M]


def summary(found: Sequence[Row]) -> Figures:
    """Figures over the runs in one world; the least coverage and the largest errors."""
    nees = np.array([row["nees"] for row in found], dtype=np.float64)
    ratios = over_reference(found)
    most = ("left_m2", "ate_m", "home_m", "keyframe_ms_p99", "memory_mb")
    return {
        "runs": len(found), "explored": sum(row["outcome"] == "explored" for row in found),
        "collisions": sum(row["collisions"] for row in found), "coverage": min(row["coverage"] for row in found),
        "nees": float(nees.mean()), "ratio_max": max(ratios, default=math.nan),
        "ratio": float(np.median(ratios)) if ratios else math.nan,
        "nees_se": float(nees.std(ddof=1) / math.sqrt(len(nees))) if len(nees) > 1 else math.nan,
        "travel_m": float(np.median([row["travel_m"] for row in found])), "slow": sum(row["slow"] for row in found),
        "times_real": sum(row["sim_s"] for row in found) / sum(row["processor_s"] for row in found),
        **{key: max(row[key] for row in found) for key in most},
    }  # fmt: skip


COLUMNS = (
    ("explored", "explored", ".0f"), ("collisions", "collisions", ".0f"), ("coverage", "coverage", ".4f"),
    ("left m²", "left_m2", ".1f"), ("NEES", "nees", ".2f"), ("±", "nees_se", ".2f"), ("ATE m", "ate_m", ".4f"),
    ("home m", "home_m", ".3f"), ("travel m", "travel_m", ".0f"), ("over nearest frontier", "ratio", ".2f"),
    ("max", "ratio_max", ".2f"), ("x real", "times_real", ".1f"), ("keyframe p99 ms", "keyframe_ms_p99", ".0f"),
    ("> 150 ms", "slow", ".0f"), ("MB", "memory_mb", ".0f"),
)  # fmt: skip


def places_at_hand() -> list[Place]:
    """The market, and the plans with where the robot begins, under SIXTHSENSE_DATA."""
    stems = [(name, Path(name).stem) for name in maps_at_hand()]
    return [Place(name, (STARTS.get(stem) or _begin(name)) if name.endswith(".yaml") else None) for name, stem in stems]


def _begin(plan: str) -> tuple[float, ...]:
    """Where the first tour of a plan begins, m and rad."""
    start = world(plan, 1000, 80.0, preset("default").robot.speed).start
    assert start is not None
    return tuple(start.array().tolist())


def main() -> int:
    parser = arguments(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--world", nargs="+", action="append", default=[], metavar="W", help="SCENE [X Y THETA]")
    parser.add_argument("--maps", action="store_true", help="market and the plans under SIXTHSENSE_DATA")
    parser.add_argument("--estimator", default="ekf-invariant")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="number of seeds (1)")
    parser.add_argument("--first-seed", type=int, default=1000, metavar="S", help="the first seed (1000)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="processes (1)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1, jobs=1)
    try:
        places = [Place(name, tuple(float(x) for x in start) or None) for name, *start in options.world]
    except ValueError as error:
        parser.error(f"--world: {error}")
    places = [*places, *(places_at_hand() if options.maps else ())] or [Place(name) for name in SHIPPED]
    try:
        base = preset("default", estimator=options.estimator, task="explore")
        configs = [dataclasses.replace(base, scene=p.scene, start=p.start) for p in places]
        for config in configs:
            mission(load_scene(config.scene, config.map_unknown), config)
    except InputError as error:
        parser.error(str(error))
    due = [dataclasses.replace(config, seed=options.first_seed + k) for config in configs for k in range(options.seeds)]
    found = list(pooled(make_row, due, options.jobs, warm_up))
    lines = [["world", "runs", *(head for head, *_ in COLUMNS)]]
    for name in dict.fromkeys(row["world"] for row in found):
        values = summary([row for row in found if row["world"] == name])
        lines.append([name, f"{values['runs']:.0f}", *(format(values[key], form) for _, key, form in COLUMNS)])
    finish(options, "explored_worlds", lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
