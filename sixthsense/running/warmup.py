"""Compilation of the hot loops, before the first run of a process: a short run is made that needs them."""

from __future__ import annotations

import atexit
import functools
import gc
from collections.abc import Callable

import numpy as np
from numba.core import event

from sixthsense.config import Config, merge
from sixthsense.core.geometry import Pose
from sixthsense.core.source import Command
from sixthsense.loop.interrupt import deferred_interrupt
from sixthsense.loop.run import run
from sixthsense.simulation.scene import Scene
from sixthsense.simulation.world import World
from sixthsense.slam.slam import Slam

WALLS = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[1, 0], [1, 1]], [[-2, 2], [-2, -2]]], dtype=np.float64)
"""of the room that the hot loops are compiled in"""

COMPILING = "compiling the hot loops, once; this takes a minute or two ..."


class _FirstCompilation(event.Listener):
    """Say once that Numba compiles, rather than loads what it has compiled before."""

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say

    def on_start(self, event: object) -> None:
        """Say that a compilation begins."""
        say, self._say = self._say, lambda _: None
        say(COMPILING)

    def on_end(self, event: object) -> None:
        """Nothing."""


def prepare(say: Callable[[str], object], config: Config | None = None, of_log: bool = False) -> None:
    """Compile the hot loops of a run, or load them compiled, once per process; `say` is told where that takes long.

    `of_log` is whether the run replays a log: with scan matching alone it needs neither a world nor a planner.
    """
    with event.install_listener("numba:compile", _FirstCompilation(say)), deferred_interrupt() as interrupted:
        if config is None or not of_log or config.front_end != "scan-matching":
            warm_up()
        if config is not None and "scan-matching" in (config.front_end, config.association.proposed_by):
            warm_up_scans()
        if interrupted():
            raise KeyboardInterrupt
    gc.freeze()  # the collections to come need not walk what has been loaded
    atexit.register(gc.unfreeze)  # else OMPL's module reports it as leaked


@functools.cache
def warm_up() -> None:
    """Compile the hot loops of a robot that explores with landmarks, or load them compiled: a run of 3 s."""
    from sixthsense.evaluation.measure import measure  # here, since a run that begins need not wait for it

    config = Config(max_time=3.0)
    scene = Scene("room", WALLS, Pose(), 0.2, (1.0, 1.0), (), (-2.0, -2.0, 2.0, 2.0))
    measure(run(config, scene=scene))


@functools.cache
def warm_up_scans() -> None:
    """Compile the hot loops of scan matching, or load them compiled: an arc of 7.5 s."""
    config = merge(Config(), {"front_end": "scan-matching"})
    source = World(WALLS, Pose(), 0.2, config, np.random.default_rng(0))
    with Slam(config) as slam:
        for _ in range(150):
            tick = source.step(Command(0.3, 0.3))
            assert tick is not None
            slam.take(tick)
        slam.finish()
