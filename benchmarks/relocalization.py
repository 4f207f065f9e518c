"""Robots that are lost in the map of an earlier run: how often and how soon they find their place.

    python benchmarks/relocalization.py --scene office --starts 50
    python benchmarks/relocalization.py --scene FOLDER/plans/Freiburg101_scan.yaml --map RUN_DIR --starts 50

The map is that of `--map`, or of an exploration with seed 1000. Starts and headings are drawn uniformly from the places
that the map has seen free, at least 0.1 m from what the robot would touch. A place is right within 0.2 m and 3 degrees
of the true start. The distance is that driven by the truth until the robot was certain.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from harness import Figures, arguments, check_at_least, machine, pooled, print_table, write_json

from sixthsense.config import Config, preset
from sixthsense.core.geometry import Array, Pose, point_segment_distance, wrap_angle
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Command, Tick
from sixthsense.loop import find_start, searching_navigator
from sixthsense.record.prior_map import prior_start
from sixthsense.running.runs import Watch, reserved, simulate
from sixthsense.running.warmup import warm_up
from sixthsense.slam.prior_map import PriorMap, PriorMapError
from sixthsense.sources.scene import Scene, load_scene
from sixthsense.sources.world import World

Row = dict[str, Any]

_RIGHT_M, _RIGHT_RAD, _SOON_M = 0.2, math.radians(3.0), 10.0
_CLEAR_M = 0.1


class _Driven:
    """A world that counts how far the robot has truly driven."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._last: Pose | None = None
        self.metres, self.collided = 0.0, False

    def step(self, command: Command) -> Tick | None:
        """The world's next tick."""
        tick = self._world.step(command)
        if tick is not None and tick.truth is not None:
            if self._last is not None:
                self.metres += math.hypot(tick.truth.x - self._last.x, tick.truth.y - self._last.y)
            self._last, self.collided = tick.truth, self.collided or tick.collided
        return tick


def starts_in(prior: PriorMap, scene: Scene, count: int, seed: int) -> list[Pose]:
    """Starts that the map has seen free."""
    rng = np.random.default_rng(seed)
    free = prior.evidence.seen & (prior.evidence.hits == 0)
    places: Array = (prior.evidence.cells[free][:, ::-1] + 0.5) * prior.cell_m
    found: list[Pose] = []
    while len(found) < count:
        place = places[rng.integers(len(places))]
        if point_segment_distance(place, scene.walls).min() > scene.radius + _CLEAR_M:
            found.append(Pose(float(place[0]), float(place[1]), float(rng.uniform(-math.pi, math.pi))))
    return found


def row_of(config: Config, folder: Path, due: tuple[int, Pose]) -> Row:
    """Look for the place of one lost robot."""
    number, start = due
    scene, prior = load_scene(config.scene, config.map_unknown), prior_start(folder, None, None, True)
    assert prior is not None
    world = World(scene.walls, start, scene.radius, config, random_streams(1000 + number).world, scene.glass)
    driven, began = _Driven(world), time.process_time()
    row: Row = {"start": start.array().tolist(), "found": False, "right": False, "off_m": None, "off_rad": None}
    try:
        _, _, found = find_start(driven, config, scene.radius, prior, searching_navigator(config, scene.radius))
    except PriorMapError:
        pass
    else:
        off_m, off_rad = math.hypot(found.x - start.x, found.y - start.y), abs(wrap_angle(found.theta - start.theta))
        row |= {"found": True, "off_m": off_m, "off_rad": off_rad}
        row["right"] = off_m <= _RIGHT_M and off_rad <= _RIGHT_RAD
    spent_s = time.process_time() - began
    return row | {"driven_m": driven.metres, "collided": driven.collided, "processor_s": spent_s}


def figures_of(rows: Sequence[Row]) -> Figures:
    """Figures of all starts."""
    right = [row for row in rows if row["right"]]
    return {
        "starts": len(rows),
        "right": len(right),
        "right_within_10_m": sum(row["driven_m"] <= _SOON_M for row in right),
        "wrong": sum(row["found"] and not row["right"] for row in rows),
        "never_certain": sum(not row["found"] for row in rows),
        "driven_m_median": float(np.median([row["driven_m"] for row in rows])),
        "driven_m_max": max(row["driven_m"] for row in rows),
        "off_m_max": max((row["off_m"] for row in right), default=math.nan),
        "collisions": sum(row["collided"] for row in rows),
        "processor_s_median": float(np.median([row["processor_s"] for row in rows])),
    }


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--scene", default="office", metavar="SCENE", help="(office)")
    parser.add_argument("--map", type=Path, metavar="RUN_DIR", help="(an exploration)")
    parser.add_argument("--starts", type=int, default=50, metavar="N", help="(50)")
    parser.add_argument("--seed", type=int, default=5, metavar="S", help="of the starts (5)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="processes (1)")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="append a JSON line for each start")
    options = parser.parse_args()
    check_at_least(parser, options, starts=1, jobs=1)
    warm_up()
    config = preset(scene=options.scene, seed=1000)
    with tempfile.TemporaryDirectory() as folder:
        if options.map is None:
            with reserved(Path(folder) / "map", config) as out:
                simulate(config, folder=out, watch=Watch(progress=False))
        known = options.map or Path(folder) / "map"
        prior = prior_start(known, None, None, True)
        assert prior is not None
        starts = starts_in(prior.map, load_scene(config.scene, config.map_unknown), options.starts, options.seed)
        rows = []
        for row in pooled(partial(row_of, config, known), list(enumerate(starts)), options.jobs, warm_up):
            rows.append(row)
            if options.rows is not None:
                with options.rows.open("a") as lines:
                    lines.write(json.dumps(row) + "\n")
    figures = figures_of(rows)
    print(machine())
    print_table([list(figures), [f"{value:.4g}" for value in figures.values()]])
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
