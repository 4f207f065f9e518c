"""One run or replay with its folder, bag, record, progress bar and hooks."""

from __future__ import annotations

import contextlib
import functools
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sixthsense.config import Config
from sixthsense.config.files import path_of
from sixthsense.loop.interrupt import deferred_interrupt
from sixthsense.running.progress import Bar, progress, seen_area

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
    """How the progress of a run is shown, and the hooks that it calls."""

    hooks: Sequence[OnTick] = ()
    """called after every tick, in this order"""
    progress: bool | None = None
    """whether a progress bar is shown; None: in a notebook and at an interactive terminal"""
    realtime: bool = False
    """slow down to real time"""
    say: Callable[[str], object] | None = None
    """prints the message that kernels are being compiled; without one the bar shows it"""
    at_end: Callable[[Run], object] | None = None
    """called with a run that is over, before it is kept: an error leaves the run in its `.partial`"""


QUIET = RunHooks(progress=False)
"""no bar and no hook"""


def reserved(
    out: str | Path | None,
    config: Config,
    overwrite: bool = False,
    replayed: Mapping[str, str] | None = None,
    prior: PriorStart | None = None,
    say: Callable[[str], object] | None = None,
) -> AbstractContextManager[RunFolder | None]:
    """The folder for a run, as `RunFolder` reserves it, or None without one; its notes go to `say`, or are warnings."""
    if out is None:
        return contextlib.nullcontext()
    from sixthsense.record.folder import RunFolder

    folder = RunFolder(path_of("out", out), config, overwrite, replayed, None if prior is None else prior.note())
    for note in folder.notes:
        (say or functools.partial(warnings.warn, stacklevel=3))(f"note: {note}")
    return folder


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
    bar = progress(f"{name}, {config.task}", config.max_time, watch.realtime, watch.progress, seen_area)
    return _watched(lambda hook: loop.run(config, hook, task, prior), name, config, bar, folder, watch)


def replay_log(
    recorded: ReplayInput, folder: RunFolder | None = None, watch: RunHooks = QUIET, prior: PriorStart | None = None
) -> Run:
    """Replay a log that has been opened, and keep the run in `folder`, if there is one.

    Raises what `simulate` raises.
    """
    from sixthsense.loop import run as loop

    log, config, relations = recorded.log, recorded.config, recorded.relations
    bar = progress(recorded.name, log.duration_s, watch.realtime, watch.progress)
    go = functools.partial(loop.replay, log, config, relations, prior=prior)
    return _watched(go, recorded.name, config, bar, folder, watch, of_log=True)


def run_live(session: Session, drive: bool, folder: RunFolder | None, watch: RunHooks, prior: PriorStart | None) -> Run:
    """Run SLAM with the robot that a session has found, and keep the run in `folder`, if there is one."""
    bar = progress("live", session.config.max_time, shown=watch.progress)
    return _watched(
        lambda hook: session.run(drive, hook, prior), "live", session.config, bar, folder, watch, of_log=not drive
    )


def _watched(
    go: Callable[[OnTick], Trace],
    name: str,
    config: Config,
    bar: AbstractContextManager[Bar],
    folder: RunFolder | None,
    watch: RunHooks,
    of_log: bool = False,
) -> Run:
    """What `go` makes of a run, called after each tick with the hooks that record, show and watch it."""
    from sixthsense.loop import run as loop
    from sixthsense.running.warmup import prepare

    if watch.say is not None:
        prepare(watch.say, config, of_log)
    with ExitStack() as open_hooks:
        advance, say = open_hooks.enter_context(bar)
        if watch.say is None:
            prepare(say, config, of_log)
            say("")
        recorded = () if folder is None else (folder.record,)
        trace = go(loop.combined_hooks(*recorded, advance, *watch.hooks))
    from sixthsense.figures.run import Run  # here, since a run that begins need not wait for what shows it at its end

    trace.name = name
    run = Run(name, trace, folder=None if folder is None else folder.out)
    with deferred_interrupt():  # a Ctrl-C after the run's end does not lose what it has found
        if watch.at_end is not None:
            watch.at_end(run)
        if folder is not None:
            _keep(folder, run, watch.say or warnings.warn)
    return run


def _keep(folder: RunFolder, run: Run, say: Callable[[str], object]) -> None:
    """Write a run that is over into its folder, its map included, and give the folder its name.

    `say` gets a line on files of others in the folder.
    """
    from sixthsense.figures.plot import save_map

    folder.write(run.trace, run.metrics)
    save_map(run, folder.partial / "map.png", _map_title(run))
    if kept := folder.finish():
        say(f"note: kept in {folder.out}, which it replaces: {', '.join(kept)}")


def _map_title(run: Run) -> str:
    """The run's title, and below it what speaks against its map."""
    is_good = run.verdict is None or run.verdict.level in ("good", "unjudged")
    return run.title if is_good else "\n".join([run.title, *textwrap.wrap(str(run.verdict), 110)])
