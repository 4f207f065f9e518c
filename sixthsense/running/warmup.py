"""Compilation of the hot loops, before the first run of a process."""

from __future__ import annotations

import atexit
import functools
import gc
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sixthsense.config import Config, merge
from sixthsense.core import kernel_cache
from sixthsense.core.geometry import Pose
from sixthsense.core.motion import STANDSTILL
from sixthsense.core.source import Command
from sixthsense.loop.run import recorded_drive
from sixthsense.navigation import make_navigator
from sixthsense.navigation.gridsearch import cheapest_way, costs_from
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.pilot import Pilot
from sixthsense.navigation.planners import make_planner
from sixthsense.navigation.visibility import mark_visible
from sixthsense.record.trace import Trace
from sixthsense.slam.features import extract
from sixthsense.slam.features.deskew import Deskewer
from sixthsense.slam.mapping.freespace import Ellipse
from sixthsense.slam.mapping.mapper import Mapper
from sixthsense.slam.slam import Slam
from sixthsense.sources.scene import Scene
from sixthsense.sources.world import World

WALLS = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[1, 0], [1, 1]], [[-2, 2], [-2, -2]]], dtype=np.float64)
"""of the room that the hot loops are compiled in"""

COMPILING = "compiling the hot loops, once; this takes about 40 s ..."


def prepare(say: Callable[[str], object], config: Config | None = None, of_log: bool = False) -> None:
    """Compile the hot loops of a run, or load them compiled, once per process; `say` is told where that takes long.

    `of_log` is whether the run replays a log: with scan matching alone it needs neither a world nor a planner.
    """
    if kernel_cache.note:
        say(f"note: {kernel_cache.note}")
    is_first = not is_compiled()
    if is_first:
        say(COMPILING)
    if config is None or not of_log or config.front_end != "scan-matching":
        # The first time all of it, since a compilation is announced; else a run loads what measures it at its end.
        warm_up() if is_first else _warm_up_drive()
    if config is not None and "scan-matching" in (config.front_end, config.association.proposed_by):
        warm_up_scans()


def is_compiled() -> bool:
    """Whether the hot loops have been compiled before, so that a run begins at once."""
    import numba

    cache: str = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    folder = Path(cache) if cache else Path(__file__).parents[1]
    return any(folder.rglob("*.nbi"))


@functools.cache
def warm_up() -> None:
    """Compile the hot loops, or load them compiled, so that the first keyframe is as quick as the rest."""
    from sixthsense.evaluation.measure import measure  # here, since a run that begins need not wait for it

    measure(_warm_up_drive())


@functools.cache
def _warm_up_drive() -> Trace:
    """The hot loops of a run, without those that measure it at its end; a run of 3 s."""
    gc.freeze()  # the collections to come need not walk what the imports before have made
    config, rng = Config(max_time=3.0), np.random.default_rng(0)
    scene = Scene("room", WALLS, Pose(), 0.2, (1.0, 1.0), (), (-2.0, -2.0, 2.0, 2.0))
    planner = make_planner("astar")
    driver = make_navigator(config, Pose(), np.zeros((0, 2)), (-3.0, -3.0, 3.0, 3.0), 0.2, rng, rng)
    trace = Trace(config, scene, 0.2)
    recorded_drive(World(WALLS, Pose(), 0.2, config, rng), Pose(), Pilot(driver, Guard(config, 0.2)), trace)
    assert trace.grid is not None
    space = trace.grid.free_space()
    for _ in range(2):  # the second is a replan
        planner.plan(space, (0.0, 0.0), (1.0, 1.0))
    # What most runs do without: scans that take time, and a search that is bounded.
    swept = merge(config, {"laser": {"sweep_s": 0.1}})
    deskew, tick = Deskewer(), World(WALLS, Pose(), 0.2, swept, rng).step(Command())
    deskew.moved(0, STANDSTILL)
    assert tick is not None and tick.scan is not None
    extract(deskew(tick.scan), config.assumed, config.features, rng)
    mapper = Mapper(config.grid, 0.2)
    mapper.add(0, lambda: np.zeros((1, 3)), tick.scan, np.zeros((0, 2, 2)))
    grid = mapper.draw()
    grid.free_space(margin_m=0.1, within=Ellipse(np.zeros(2), np.ones(2), 1.0))
    grid.compose([grid.submap()])
    _warm_up_choice()
    _keep_imports()
    return trace


def _warm_up_choice() -> None:
    """What a choice of a view needs later than the first one: views that failed, and ways over dear cells."""
    free, here = np.ones((60, 60), dtype=np.bool_), (30, 30)
    mark_visible(free.copy(), ~free, free.copy(), *here, 3.0)
    prices = free.astype(np.uint8)
    cheapest_way(prices, costs_from(prices, *here), 0, 0)


def _keep_imports() -> None:
    """What the imports left behind is there to stay: a collection that walks it takes as long as sixty keyframes.

    Until the process ends: OMPL's module reports what is never collected as leaked.
    """
    gc.collect()
    gc.freeze()
    if "ompl" in sys.modules:  # without it the last collection would take its time for nothing
        atexit.register(gc.unfreeze)


@functools.cache
def warm_up_scans() -> None:
    """Compile the hot loops of scan matching, or load them compiled: tracking, links and loop closures."""
    # Here, so that runs with landmarks do not load them.
    from sixthsense.slam.scans.places import Apart, Window, peaks, pyramid, submap_points
    from sixthsense.slam.scans.returns import ScanStore
    from sixthsense.slam.scans.uncertainty import UncertaintyGraph
    from sixthsense.slam.scans.visibility import explained

    config = merge(Config(), {"front_end": "scan-matching"})
    source, store = World(WALLS, Pose(), 0.2, config, np.random.default_rng(0)), ScanStore(config.scans.max_range_m)
    with Slam(config) as slam:
        for _ in range(150):
            tick = source.step(Command(0.3, 0.3))
            assert tick is not None
            slam.take(tick)
            if tick.scan is not None:
                store.put(tick.scan)
                store.keep()
        slam.finish()
    points = submap_points(store.returns, np.arange(1), np.zeros((1, 3)), 0.05)
    peaks(pyramid(points), points, Window(np.zeros(3), 0.8, 0.1), 0.2, Apart(0.7, 0.2))
    explained(store.returns, 0, 0, np.zeros(3))
    graph = UncertaintyGraph()
    graph.add(0, 1, 1.0, 1.0)
    graph.sigmas(0, np.zeros((2, 3)))
    _keep_imports()
