"""Compilation of the hot loops, before the first run of a process."""

from __future__ import annotations

import functools
import gc
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sixthsense.config import Config, merge
from sixthsense.core.geometry import Pose
from sixthsense.core.motion import STANDSTILL
from sixthsense.core.source import Command
from sixthsense.evaluation.measure import measure
from sixthsense.loop import recorded_drive
from sixthsense.navigation.exploration_navigator import ExplorationNavigator
from sixthsense.navigation.follower import Follower
from sixthsense.navigation.planners import make_planner
from sixthsense.record.trace import Trace
from sixthsense.slam.features import extract
from sixthsense.slam.features.deskew import Deskewer
from sixthsense.slam.mapping.mapper import Mapper
from sixthsense.sources.scene import Scene
from sixthsense.sources.world import World

COMPILING = "compiling the hot loops, once; this takes about half a minute ..."


def prepare(say: Callable[[str], object]) -> None:
    """Compile the hot loops, or load them compiled, once per process; `say` is told where that takes long."""
    if not is_compiled():
        say(COMPILING)
    _warm_up_once()


def is_compiled() -> bool:
    """Whether the hot loops have been compiled before, so that a run begins at once."""
    import numba

    cache: str = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    folder = Path(cache) if cache else Path(__file__).parents[1]
    return any(folder.rglob("*.nbi"))


@functools.cache
def _warm_up_once() -> None:
    warm_up()


def warm_up() -> None:
    """Compile the hot loops, or load them compiled, so that the first key scan is as quick as the rest."""
    walls = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[1, 0], [1, 1]], [[-2, 2], [-2, -2]]], dtype=np.float64)
    config = Config(max_time=3.0)
    scene = Scene("room", walls, Pose(), 0.2, (1.0, 1.0), (), (-2.0, -2.0, 2.0, 2.0))
    rng = np.random.default_rng(0)
    follower = Follower(config.follow, config.robot)
    planner = make_planner("astar")
    driver = ExplorationNavigator(Pose(), (-3.0, -3.0, 3.0, 3.0), 0.2, planner, follower, config, rng)
    trace = Trace(config, scene, 0.2)
    recorded_drive(World(walls, Pose(), 0.2, config, rng), Pose(), driver, trace)
    measure(trace)
    assert trace.grid is not None
    space = trace.grid.free_space()
    for _ in range(2):  # the second is a replan
        planner.plan(space, (0.0, 0.0), (1.0, 1.0))
    # What most runs do without: scans that take time, and a search that is bounded.
    swept = merge(config, {"laser": {"sweep_s": 0.1}})
    deskew, tick = Deskewer(), World(walls, Pose(), 0.2, swept, rng).step(Command())
    deskew.moved(0, STANDSTILL)
    assert tick is not None and tick.scan is not None
    extract(deskew(tick.scan), config.assumed, config.features, rng)
    mapper = Mapper(config.grid, 0.2)
    mapper.add(np.zeros((1, 3)), tick.scan, np.zeros((0, 2, 2)))
    mapper.grid.free_space(margin_m=0.1).between((0.0, 0.0), (1.0, 0.0), 1.0)
    # What the imports left behind is there to stay: a collection that walks it takes as long as sixty key scans.
    gc.collect()
    gc.freeze()
