"""`ss.run` and `ss.replay`, the calls for notebooks and scripts: arguments are converted to a configuration."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from sixthsense.config import Config, preset
from sixthsense.config.errors import InputError
from sixthsense.config.files import path_of
from sixthsense.config.parts import EXPLORERS, PLANNERS, import_named
from sixthsense.config.section import shown
from sixthsense.config.tree import applied, own_parts, part_of
from sixthsense.core.random_streams import random_streams
from sixthsense.running.runs import RunHooks, replay_log, reserved, simulate

if TYPE_CHECKING:
    from sixthsense.config.fields import MergeFields, ReplayFields, RunFields
    from sixthsense.figures.run import Run
    from sixthsense.logs.log import Log, Relations
    from sixthsense.logs.replay_input import LogSelection, ReplayInput
    from sixthsense.loop.run import OnTick
    from sixthsense.slam.prior_map import PriorStart

_log = logging.getLogger(__name__)


def run(
    scene: str | Path | Config = "apartment",
    /,
    on_tick: OnTick | None = None,
    *,
    progress: bool | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    prior_map: str | Path | None = None,
    **fields: Unpack[RunFields],
) -> Run:
    """Simulate a robot in a scene unknown to it; the robot explores the scene or drives to goals.

        run = ss.run("apartment", estimator="isam2", seed=3)
        run.plot(); run.metrics

    Parameters
    ----------
    scene
        A shipped scene's name, a file (.toml or map_server .yaml), or a complete `Config`.
    on_tick
        Called after every tick with the tick and the trace so far.
    progress
        Whether to show a progress bar; by default in a notebook and at a terminal.
    out, overwrite
        Folder to write, none by default, which `ss.load` reads; whether to replace an existing one.
    prior_map
        Folder of an earlier run in this building, whose map the run begins with, at `pose` (x, y, theta; by default the
        start) with the standard deviations `pose_sigma` (by default 0). With `lost=True` it does not know where, and
        drives until it has found out.
    **fields
        Fields of the configuration by name: `estimator`, `planner`, `preset`, `seed`, `max_time` (simulated seconds),
        `task` ("explore", "goal", "tour"), `goal` (x, y) and `start` (x, y, theta) in metres and radians, world frame;
        sections as tables, `laser={"beams": 181}`, or as objects, `laser=ss.LaserConfig(beams=181)`: what they state
        replaces the preset's values. `estimator` and `planner` may be a class or function of your own at the top level
        of a module, or its import path, "lab.fading:Fading"; their options are `estimator_options={"gain": 0.9}`.

    Returns
    -------
    Run
        Record (`run.trace`), metrics and figures. Ctrl-C and the notebook's stop button return the run so far with
        the outcome "interrupted". A second interrupt within two seconds raises KeyboardInterrupt.

    Raises
    ------
    InputError
        One line each: a field or value that is not allowed; an invalid scene, start or goal; a folder that exists, or
        cannot be written; a prior map that is damaged, or of another building.

    """
    from sixthsense.simulation.mission import mission_of

    given = dict(fields)
    prior = _prior_start(prior_map, given)
    config, task = mission_of(_of_scene(scene, given))
    _note(task.scene.name, task.scene.notes)
    with reserved(out, config, overwrite, prior=prior) as folder:
        return simulate(config, task, folder, RunHooks(on_tick, progress), prior)


def replay(  # noqa: PLR0913
    log: str | Path | Log,
    config: Config | None = None,
    relations: str | Path | Relations | None = None,
    on_tick: OnTick | None = None,
    *,
    topics: Sequence[str] = (),
    odometry_frames: Sequence[str] = (),
    robot: int | None = None,
    progress: bool | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    prior_map: str | Path | None = None,
    **fields: Unpack[ReplayFields],
) -> Run:
    """Process a recorded log with the same loop as `ss.run`.

        run = ss.replay("intel.clf.bz2", relations="intel.relations", estimator="isam2")

    Parameters
    ----------
    log
        A CARMEN file (.log, .clf) or a graph of landmarks (.graph, .g2o, .txt), plain or compressed; a ROS 1 or
        ROS 2 bag; the folder of a run; an MRCLAM folder; or a log opened by `ss.open_log`.
    config
        The complete configuration. By default it is that of the run folder, or the preset of the log's format ("log",
        "victoria", "mrclam"). An opened log needs one.
    relations
        Hand-checked relations between poses, or their file, the reference of the trajectory's error.
    on_tick, progress, out, overwrite, prior_map
        What they are for `ss.run`. The robot begins at the log's start, or at `pose`.
    topics, odometry_frames, robot
        Topics to use from a bag with several of scans or odometry; parent and child of its odometry in /tf; robot
        to use from an MRCLAM folder.
    **fields
        Fields that override the configuration, as in `ss.run`, except those of the simulation.

    Returns
    -------
    Run
        What `ss.run` returns.

    Raises
    ------
    InputError
        One line each: what is not allowed on a replay, and what cannot be read, with file and line.

    """
    from sixthsense.logs.replay_input import LogSelection

    given = dict(fields)
    prior = _prior_start(prior_map, given)
    found = _opened(log, config, relations, LogSelection(topics, robot, odometry_frames), given, out)
    _note(found.name, found.notes)
    with reserved(out, found.config, overwrite, found.files or None, prior) as folder:
        return replay_log(found, folder, RunHooks(on_tick, progress), prior)


def merge_runs(
    first: str | Path,
    second: str | Path,
    on_tick: OnTick | None = None,
    config: Config | None = None,
    *,
    progress: bool | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    **fields: Unpack[MergeFields],
) -> Run:
    """Map two runs in one building together: scans of both are aligned, in the frame of the first.

        run = ss.merge_runs("runs/monday", "runs/tuesday", out="runs/both")

    Parameters
    ----------
    first, second
        Folders of runs with scans of one laser. The second is found in the map of the first by what it has seen.
    on_tick, progress, out, overwrite
        What they are for `ss.replay`.
    config
        The complete configuration, by default that of the first run.
    **fields
        Fields that override the configuration, as in `ss.replay`.

    Returns
    -------
    Run
        What `ss.replay` returns, of a log with the ticks of both runs.

    Raises
    ------
    InputError
        One line each: what `ss.replay` raises; two runs with different lasers, that share no place, or
        that contradict each other.

    """
    from sixthsense.config import load_config
    from sixthsense.logs.replay_input import check_options, check_out
    from sixthsense.running.merging import open_merged, replay_merged

    first, second = path_of("first", first), path_of("second", second)
    check_options(first, fields)
    for run in (first, second):
        check_out(run, None if out is None else path_of("out", out))
    merged = open_merged(first, second, configured(config or load_config(first / "config.toml"), fields))
    for note in merged.notes:
        _log.info(f"note: {note}")
    with reserved(out, merged.config, overwrite, merged.files) as folder:
        return replay_merged(merged, folder, RunHooks(on_tick, progress))


def _of_scene(scene: str | Path | Config, given: dict[str, Any]) -> Config:
    """The configuration of a run from the scene, or the complete configuration, and the given fields."""
    if isinstance(scene, Config):
        return configured(scene, given)
    if "scene" in given:
        raise InputError("scene", f"found {shown(given['scene'])} beside {shown(str(scene))}", "one scene")
    return configured(given.pop("preset", "default"), {**given, "scene": str(path_of("scene", scene))})


def _prior_start(prior_map: str | Path | None, given: dict[str, Any]) -> PriorStart | None:
    """The prior map and the start in it, whose fields are taken out of `given`."""
    from sixthsense.record.store import prior_start

    return prior_start(prior_map, **{name: given.pop(name, None) for name in ("pose", "pose_sigma", "lost")})


def _opened(
    log: str | Path | Log,
    config: Config | None,
    relations: str | Path | Relations | None,
    chosen: LogSelection,
    given: dict[str, Any],
    out: str | Path | None,
) -> ReplayInput:
    """The input of a replay from a log's file or folder, or from a log that the caller has opened."""
    from sixthsense.logs.replay_input import base_of, check_options, check_out, of_opened, open_recorded

    if isinstance(log, str | Path):
        check_options(log, given, chosen.given())
        check_out(log, None if out is None else path_of("out", out))
        base = (given.pop("preset", None) or base_of(log)) if config is None else config
        return open_recorded(log, configured(base, given), relations, chosen)
    if not hasattr(log, "ticks"):
        raise InputError("log", f"found {shown(log)}", "a file or folder of a log, or an opened log")
    if config is None:
        raise InputError("config", "found none for an opened log", "a Config, such as ss.preset()")
    return of_opened(log, configured(config, given), relations)


def _note(name: str, notes: Sequence[str]) -> None:
    """Log what a user may want to know about a scene or a log."""
    for note in notes:
        _log.info(f"note: {name}: {note}")


def configured(base: str | Config, given: Mapping[str, Any]) -> Config:
    """A preset or a complete configuration with the given fields; parts of a user's own are made once.

    Raises InputError for a field that is not allowed, and PartError for a part that cannot be made, or has not what its
    contract asks for, before anything is compiled or written.
    """
    if isinstance(base, Config) and "preset" in given:
        raise InputError("preset", f"found {shown(given['preset'])} with a complete configuration", "fields")
    import_named(given)
    found = applied(base if isinstance(base, Config) else preset(base), given)
    if own_parts(found):
        from sixthsense.slam.slam import Slam

        with Slam(found):
            for kind in (PLANNERS, EXPLORERS):
                part_of(found, kind).make(random_streams(found.seed).planner)
    return found
