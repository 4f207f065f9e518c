"""Compilation of the hot loops, before the first run of a process.

The first time, two processes compile: this one begins with SLAM, a second one with what comes late, and each loads what
the other has compiled by the time that it needs it.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
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
from sixthsense.simulation.scene import Scene
from sixthsense.simulation.world import World
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.features import extract
from sixthsense.slam.features.deskew import Deskewer
from sixthsense.slam.mapping.freespace import Ellipse
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Mapper
from sixthsense.slam.slam import Slam

WALLS = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[1, 0], [1, 1]], [[-2, 2], [-2, -2]]], dtype=np.float64)
"""of the room that the hot loops are compiled in"""

COMPILING = "compiling the hot loops, once; this takes about half a minute ..."


def prepare(say: Callable[[str], object], config: Config | None = None, of_log: bool = False) -> None:
    """Compile the hot loops of a run, or load them compiled, once per process; `say` is told where that takes long.

    `of_log` is whether the run replays a log: with scan matching alone it needs neither a world nor a planner.
    """
    if kernel_cache.note:
        say(f"note: {kernel_cache.note}")
    drives = config is None or not of_log or config.front_end != "scan-matching"
    matches = config is not None and "scan-matching" in (config.front_end, config.association.proposed_by)
    is_first = not is_compiled(drives, matches)
    if is_first:
        say(COMPILING)
    with _second_process(drives, matches) if is_first else contextlib.nullcontext():
        if drives:
            # The first time all of it, since a compilation is announced; else a run loads what measures it at its end.
            warm_up() if is_first else _warm_up_drive()
        if matches:
            warm_up_scans()


@contextlib.contextmanager
def _second_process(drives: bool, matches: bool) -> Iterator[None]:
    """Compile in a second process, too, where there is a processor for it and the kernels are kept in files."""
    is_alone = multiprocessing.parent_process() is None  # else others compile beside it
    is_kept = not kernel_cache.note and kernel_cache.write_in_turn()
    if not (is_alone and is_kept and sys.executable and (os.cpu_count() or 1) > 1):
        yield
        return
    program = f"from sixthsense.running.warmup import warm_up_beside; warm_up_beside({drives}, {matches})"
    env = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command, none = [sys.executable, "-c", program], subprocess.DEVNULL
    with subprocess.Popen(command, env=env, stdin=none, stdout=none, stderr=none) as second:
        try:
            yield
        finally:
            with kernel_cache.in_turn():  # not while it writes
                second.kill()  # this process has all that it needs


def warm_up_beside(drives: bool, matches: bool) -> None:
    """What a second process compiles, the last first."""
    kernel_cache.write_in_turn()
    if matches:
        _warm_up_links()
    if drives:
        _warm_up_navigation()


def is_compiled(drives: bool = True, matches: bool = False) -> bool:
    """Whether the hot loops of a robot that drives, and of scan matching, have been compiled before.

    A run with those that it needs begins at once. Each of both has a kernel that nothing else compiles.
    """
    import numba

    cache: str = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    folder = Path(cache) if cache else Path(__file__).parents[1]
    kernels = [name for name, is_needed in (("frontier.*.nbi", drives), ("tracking.track-*.nbi", matches)) if is_needed]
    return all(any(folder.rglob(name)) for name in kernels)


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
    driver = make_navigator(config, Pose(), np.zeros((0, 2)), (-3.0, -3.0, 3.0, 3.0), 0.2, rng, rng)
    trace = Trace(config, scene, 0.2)
    recorded_drive(World(WALLS, Pose(), 0.2, config, rng), Pose(), Pilot(driver, Guard(config, 0.2)), trace)
    assert trace.grid is not None
    _warm_up_plans(trace.grid)
    # What most runs do without: scans that take time, and a search that is bounded.
    swept = merge(config, {"laser": {"sweep_s": 0.1}})
    deskew, tick = Deskewer(), World(WALLS, Pose(), 0.2, swept, rng).step(Command())
    deskew.moved(0, STANDSTILL)
    assert tick is not None and tick.scan is not None
    extract(deskew(tick.scan), config.assumed, config.features, rng)
    mapper = Mapper(config.grid, 0.2)
    mapper.add(0, lambda: np.zeros((1, 3)), tick.scan, np.zeros((0, 2, 2)))
    _warm_up_map(mapper.draw())
    _keep_imports()
    return trace


def _warm_up_map(grid: Grid) -> None:
    """Parts of a map, and one that is composed of submaps."""
    grid.free_space(margin_m=0.1, within=Ellipse(np.zeros(2), np.ones(2), 1.0))
    grid.compose([grid.submap()])


def _warm_up_navigation() -> None:
    """What plans and drives, on a map of true poses; and what measures a run at its end."""
    from sixthsense.evaluation.coverage import visible_area  # here, as in `warm_up`

    config, rng = Config(), np.random.default_rng(0)
    source, mapper, command = World(WALLS, Pose(), 0.2, config, rng), Mapper(config.grid, 0.2), Command()
    poses = np.zeros((60, 3))
    navigator = make_navigator(config, Pose(), np.zeros((0, 2)), (-3.0, -3.0, 3.0, 3.0), 0.2, rng, rng)
    for k in range(len(poses)):
        tick = source.step(command)
        assert tick is not None and tick.truth is not None
        poses[k] = tick.truth.array()
        if tick.scan is not None:
            mapper.add(k, lambda: poses, tick.scan, np.zeros((0, 2, 2)))
            navigator.look(mapper.draw(), Estimate.of_pose(tick.truth, 1e-6 * np.eye(3)))
        command = navigator.step(tick.truth, tick.stamp_ns)
    _warm_up_plans(mapper.grid)
    _warm_up_map(mapper.grid)
    visible_area(WALLS, (-3.0, -3.0, 3.0, 3.0), (0.0, 0.0), 0.2, 5.0)


def _warm_up_plans(grid: Grid) -> None:
    """Ways and a replan, and what a choice of a view needs later than the first: views that failed, and dear cells."""
    planner, space = make_planner("astar"), grid.free_space()
    for _ in range(2):  # the second is a replan
        planner.plan(space, (0.0, 0.0), (1.0, 1.0))
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
    config = merge(Config(), {"front_end": "scan-matching"})
    source = World(WALLS, Pose(), 0.2, config, np.random.default_rng(0))
    with Slam(config) as slam:
        for _ in range(150):
            tick = source.step(Command(0.3, 0.3))
            assert tick is not None
            slam.take(tick)
        slam.finish()
    _warm_up_links()
    _keep_imports()


@functools.cache
def _warm_up_links() -> None:
    """Links of keyframes and the search for places, of two scans."""
    # Here, so that runs with landmarks do not load them.
    from sixthsense.slam.scans.links import align_pairs, covariances, private_covariance, reported
    from sixthsense.slam.scans.places import Apart, Window, peaks, pyramid, submap_points
    from sixthsense.slam.scans.returns import ScanStore
    from sixthsense.slam.scans.uncertainty import UncertaintyGraph
    from sixthsense.slam.scans.visibility import explained

    config = merge(Config(), {"front_end": "scan-matching"})
    source, store = World(WALLS, Pose(), 0.2, config, np.random.default_rng(0)), ScanStore(config.scans.max_range_m)
    while store.count < 2:
        tick = source.step(Command(0.3, 0.3))
        assert tick is not None
        if tick.scan is not None:
            store.put(tick.scan)
            store.keep()
    one = np.arange(1)
    links = align_pairs(store.returns, one, one + 1, np.zeros((1, 3)), 0.25)
    covariances(links.sums, np.array([2.0]), 0.01)
    own = private_covariance(store.returns, 0, 0.01)
    reported(own, np.zeros(3), own, own, np.zeros(3))
    points = submap_points(store.returns, np.arange(1), np.zeros((1, 3)), 0.05)
    peaks(pyramid(points), points, Window(np.zeros(3), 0.8, 0.1), 0.2, Apart(0.7, 0.2))
    explained(store.returns, 0, 0, np.zeros(3))
    graph = UncertaintyGraph()
    graph.add(0, 1, 1.0, 1.0)
    graph.sigmas(0, np.zeros((2, 3)))
