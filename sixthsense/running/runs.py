"""One run or replay with its folder, bag, record, progress bar and hooks."""

from __future__ import annotations

import contextlib
import functools
import textwrap
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sixthsense.config import Config
from sixthsense.config.files import Note, path_of
from sixthsense.loop.interrupt import deferred_interrupt
from sixthsense.running.progress import progress, seen_area

if TYPE_CHECKING:
    from sixthsense.figures.run import Run
    from sixthsense.live.session import Session
    from sixthsense.logs.replay_input import ReplayInput
    from sixthsense.loop.run import OnTick
    from sixthsense.record.folder import RunFolder
    from sixthsense.record.trace import Trace
    from sixthsense.simulation.mission import Mission
    from sixthsense.slam.prior_map import PriorStart


@dataclass(frozen=True, slots=True)
class RunHooks:
    """Whether the progress of a run is shown, and what it calls."""

    on_tick: OnTick | None = None
    """called after every tick"""
    progress: bool | None = None
    """whether a progress bar is shown; None: in a notebook and at an interactive terminal"""
    at_end: Callable[[Run], object] | None = None
    """called with a run that is over, before it is kept: an error leaves the run in its `.partial`"""


QUIET = RunHooks(progress=False)
"""no bar and no hook"""


def reserved(
    out: str | Path | None, config: Config, overwrite: bool, replayed: Note = None, prior: PriorStart | None = None
) -> AbstractContextManager[RunFolder | None]:
    """The folder for a run, as `RunFolder` reserves it, or None without one."""
    if out is None:
        return contextlib.nullcontext()
    from sixthsense.record.folder import RunFolder

    return RunFolder(path_of("out", out), config, overwrite, replayed, None if prior is None else prior.note())


def simulate(
    config: Config,
    task: Mission,
    folder: RunFolder | None = None,
    watch: RunHooks = QUIET,
    prior: PriorStart | None = None,
) -> Run:
    """Simulate a task, and keep the run in `folder`, if there is one.

    With `prior` the robot begins with the map of an earlier run. Raises InputError for a prior map that cannot be used;
    OSError, naming the file, for one that cannot be written.
    """
    from sixthsense.loop import run as loop

    name = task.scene.name
    bar = progress(f"{name}, {config.task}", config.max_time, watch.progress, seen_area)
    return _watched(lambda hook: loop.run(config, hook, task, prior), name, config, bar, folder, watch)


def replay_log(
    recorded: ReplayInput, folder: RunFolder | None = None, watch: RunHooks = QUIET, prior: PriorStart | None = None
) -> Run:
    """Replay a log that has been opened, and keep the run in `folder`, if there is one.

    Raises what `simulate` raises.
    """
    from sixthsense.loop import run as loop

    log, config, relations = recorded.log, recorded.config, recorded.relations
    bar = progress(recorded.name, log.duration_s, watch.progress)
    go = functools.partial(loop.replay, log, config, relations, prior=prior)
    return _watched(go, recorded.name, config, bar, folder, watch, of_log=True)


def run_live(session: Session, drive: bool, folder: RunFolder | None, watch: RunHooks, prior: PriorStart | None) -> Run:
    """Run SLAM with the robot that a session has found, and keep the run in `folder`, if there is one."""
    bar = progress("live", session.config.max_time, shown=watch.progress)
    go = functools.partial(session.run, drive, prior=prior)
    return _watched(go, "live", session.config, bar, folder, watch, of_log=not drive)


def _watched(
    go: Callable[[OnTick], Trace],
    name: str,
    config: Config,
    bar: AbstractContextManager[tuple[OnTick, Callable[[str], object]]],
    folder: RunFolder | None,
    watch: RunHooks,
    of_log: bool = False,
) -> Run:
    """What `go` makes of a run, called after each tick with the hooks that record, show and watch it."""
    from sixthsense.loop import run as loop
    from sixthsense.running.warmup import prepare

    with bar as (advance, say):
        prepare(config, of_log, say)
        say("")
        trace = go(loop.combined_hooks(None if folder is None else folder.record, advance, watch.on_tick))
    from sixthsense.figures.plot import save_map
    from sixthsense.figures.run import Run  # here, since a run that begins need not wait for what shows it at its end

    trace.name = name
    run = Run(name, trace, folder=None if folder is None else folder.out)
    with deferred_interrupt():  # a Ctrl-C after the run's end does not lose what it has found
        if watch.at_end is not None:
            watch.at_end(run)
        if folder is not None:
            folder.write(trace, run.metrics)
            is_good = run.verdict is None or run.verdict.level in ("good", "unjudged")
            below = () if is_good else textwrap.wrap(str(run.verdict), 110)
            save_map(run, folder.partial / "map.png", "\n".join([run.title, *below]))
            folder.finish()
    return run
