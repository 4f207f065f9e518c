"""Compilation of the hot loops, before the first run of a process: a short run is made that needs them."""

from __future__ import annotations

import atexit
import functools
import gc
import logging
from collections.abc import Callable

import numpy as np
from numba.core import event

from sixthsense.config import Config, merge
from sixthsense.core.geometry import Pose
from sixthsense.loop.interrupt import deferred_interrupt
from sixthsense.loop.run import run
from sixthsense.simulation.scene import Scene

WALLS = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[1, 0], [1, 1]], [[-2, 2], [-2, -2]]], dtype=np.float64)
"""of the room that the hot loops are compiled in"""

_log = logging.getLogger(__name__)
COMPILING = "compiling the hot loops, once; this takes a minute or two ..."


class _FirstCompilation(event.Listener):
    """Say once that Numba compiles, rather than loads what it has compiled before."""

    def __init__(self, *says: Callable[[str], object]) -> None:
        self._says = says

    def on_start(self, event: object) -> None:
        """Say that a compilation begins."""
        for say in self._says:
            say(COMPILING)
        self._says = ()

    def on_end(self, event: object) -> None:
        """Nothing."""


def prepare(
    config: Config | None = None, of_log: bool = False, say: Callable[[str], object] = lambda text: None
) -> None:
    """Compile the hot loops of a run, or load them compiled, once per process; where that takes long, log and `say` it.

    `of_log` is whether the run replays a log: with scan matching alone it needs neither a world nor a planner.
    """
    with (
        event.install_listener("numba:compile", _FirstCompilation(_log.info, say)),
        deferred_interrupt() as interrupted,
    ):
        if config is None or not of_log or config.front_end != "scan-matching":
            warm_up()
        if config is not None and "scan-matching" in (config.front_end, config.association.proposed_by):
            warm_up("scan-matching")
        if interrupted():
            raise KeyboardInterrupt
    gc.freeze()  # the collections to come need not walk what has been loaded
    atexit.register(gc.unfreeze)  # else OMPL's module reports it as leaked


@functools.cache
def warm_up(front_end: str = "landmarks") -> None:
    """Compile the hot loops of a robot that explores, or load them compiled: a run of 3 s with a front end."""
    from sixthsense.evaluation.measure import measure  # here, since a run that begins need not wait for it

    config = merge(Config(max_time=3.0), {"front_end": front_end})
    scene = Scene("room", WALLS, Pose(), 0.2, (1.0, 1.0), (), (-2.0, -2.0, 2.0, 2.0))
    measure(run(config, scene=scene))
