"""The calls of a notebook or a script: a run or a replay by names, with a progress bar, kept in a folder if asked."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.config import Config, ConfigError, merge, preset
from sixthsense.config.section import shown
from sixthsense.running.runs import Watch, replay_log, reserved, simulate

if TYPE_CHECKING:
    from sixthsense.figures.run import Run
    from sixthsense.loop import OnTick
    from sixthsense.sources.logs.log import Log
    from sixthsense.sources.logs.relations import Relations
    from sixthsense.sources.replay_input import Recorded


def run(
    scene: str | Path | Config = "apartment",
    /,
    on_tick: OnTick | None = None,
    *,
    progress: bool | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    **fields: Any,
) -> Run:
    """Put a robot into a scene it has never seen, and let it see all of it or reach its goals.

        run = ss.run("apartment", estimator="isam2", seed=3)
        run.plot(); run.metrics

    Parameters
    ----------
    scene
        A shipped scene's name, a file (.toml, map_server .yaml, .scn), or a whole `Config`.
    on_tick
        Called after every tick with it and the trace so far.
    progress
        Whether a bar shows how far it is; by default in a notebook and at a terminal.
    out, overwrite
        Folder to write, which `ss.load` reads back, none by default; whether to replace it if it exists.
    **fields
        Of the configuration, by name: `estimator`, `planner`, `preset`, `seed`, `max_time` (simulated seconds),
        `task` ("explore", "goal", "tour"), `goal` (x, y) and `start` (x, y, theta) in metres and radians, world frame;
        sections as mappings, `laser={"beams": 181}`. `estimator` and `planner` may be your own class or function (see
        `ss.register_estimator`).

    Returns
    -------
    Run
        Its record (`run.trace`), metrics and figures. Ctrl-C and the notebook's stop button return the run so far with
        the outcome "interrupted". A second interrupt within two seconds raises KeyboardInterrupt.

    Raises
    ------
    ConfigError, SceneError, FolderError
        One line each: a field or value that is not allowed; a scene that cannot be read, a start or goal outside it or
        in a wall; a folder that exists, or cannot be written.

    """
    from sixthsense.sources.mission import mission
    from sixthsense.sources.scene import load_scene

    given = _named(fields)
    if isinstance(scene, Config):
        config = _over(scene, given)
    else:
        if "scene" in given:
            raise ConfigError(f"scene: found {shown(given['scene'])} beside {shown(str(scene))}, allowed: one scene")
        config = _over(given.pop("preset", "default"), {**given, "scene": str(scene)})
    config = with_task(config, given)
    there = load_scene(config.scene)
    mission(there, config)
    with reserved(out, config, overwrite) as folder:
        return simulate(config, there, folder, _watch(on_tick, progress))


def replay(
    log: str | Path | Log,
    config: Config | None = None,
    relations: str | Path | Relations | None = None,
    on_tick: OnTick | None = None,
    *,
    topics: Sequence[str] = (),
    robot: int | None = None,
    progress: bool | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    **fields: Any,
) -> Run:
    """Process a recorded log with the same loop as `ss.run`.

        run = ss.replay("intel.clf.bz2", relations="intel.relations", estimator="isam2")

    Parameters
    ----------
    log
        A CARMEN file (.log, .clf) or a graph of landmarks (.graph, .g2o, .toro, .txt), plain, .gz or .bz2; a ROS 1 or
        ROS 2 bag; the folder of a run; a folder of MRCLAM; or a log that `ss.open_log` has opened.
    config
        The whole configuration; by default that of the run whose folder it is, else the preset of the log's kind
        ("intel", "victoria", "mrclam"; of a bag "default"). An opened log needs one.
    relations
        Hand-checked relations between poses, or their file, to measure the trajectory against.
    on_tick, progress, out, overwrite
        As of `ss.run`.
    topics, robot
        Topics of a bag to use, where it has several of scans or of odometry; robot of a MRCLAM folder to follow.
    **fields
        Of the configuration, over all that, as of `ss.run`, but none of the simulated robot's.

    Returns
    -------
    Run
        As of `ss.run`.

    Raises
    ------
    ConfigError, LogError
        One line each: a field or value that is not allowed, for this kind of log; a log or relations that cannot be
        read, with file and line.

    """
    given = _named(fields)
    if isinstance(log, (str, Path)):
        found = _opened(Path(log), config, relations, topics, robot, given, out)
    else:
        from sixthsense.sources.logs.relations import read_relations
        from sixthsense.sources.replay_input import Recorded

        if config is None:
            raise ConfigError("config: found none beside a log that is open, allowed: a Config, such as ss.preset()")
        judged = read_relations(relations) if isinstance(relations, (str, Path)) else relations
        found = Recorded("log", log, _over(config, given), judged, {}, ())
    with reserved(out, found.config, overwrite, found.files or None) as folder:
        return replay_log(found, folder, _watch(on_tick, progress))


def _opened(
    log: Path,
    config: Config | None,
    relations: str | Path | Relations | None,
    topics: Sequence[str],
    robot: int | None,
    given: dict[str, Any],
    out: str | Path | None,
) -> Recorded:
    """Open a log's file or folder with the configuration that goes with it."""
    from sixthsense.sources.replay_input import base_of, check_options, check_out, open_recorded

    check_options(log, given, bool(topics), robot is not None)
    if config is not None and "preset" in given:
        raise ConfigError(f"preset: found {shown(given['preset'])} over a whole configuration, allowed: fields")
    base = given.pop("preset", None) if config is None else config
    check_out(log, None if out is None else Path(out))
    return open_recorded(log, _over(base_of(log) if base is None else base, given), relations, topics, robot)


def _watch(on_tick: OnTick | None, progress: bool | None) -> Watch:
    return Watch(() if on_tick is None else (on_tick,), progress)


def with_task(config: Config, given: Mapping[str, Any], prefix: str = "") -> Config:
    """The configuration with what follows from the fields that were given: a goal is the task goal's.

    A scene's file is named whole, so that the run can be repeated wherever one stands. Raises ConfigError for a goal
    with another task; `prefix` stands before the fields' names.
    """
    if given.get("goal") is not None:
        if given.get("task", "goal") != "goal":
            allowed = f"allowed: with {prefix}task goal"
            raise ConfigError(f"{prefix}goal: found with {prefix}task {shown_word(given['task'])}, {allowed}")
        config = dataclasses.replace(config, task="goal")
    if Path(config.scene).suffix:
        config = dataclasses.replace(config, scene=str(Path(config.scene).resolve()))
    return config


def shown_word(value: Any) -> str:
    """A word as it is, anything else as a complaint shows it."""
    return value if isinstance(value, str) else shown(value)


def _over(base: str | Config, given: Mapping[str, Any]) -> Config:
    """The fields that were given over a preset or a whole configuration."""
    if isinstance(base, Config) and "preset" in given:
        raise ConfigError(f"preset: found {shown(given['preset'])} over a whole configuration, allowed: fields")
    return merge(base if isinstance(base, Config) else preset(base), given)


def _named(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The fields, with back ends and planners of one's own registered and named."""
    from sixthsense.navigation.planners import register_planner
    from sixthsense.slam.estimators import register_estimator

    given = dict(fields)
    registers: dict[str, Callable[[str, Any], None]] = {"estimator": register_estimator, "planner": register_planner}
    for field, register in registers.items():
        value = given.get(field)
        if callable(value):
            name = getattr(value, "__name__", type(value).__name__)
            try:
                register(name, value)
            except ValueError as error:
                raise ConfigError(f"{field}: {error}") from None
            given[field] = name
    return given
