"""A recorded log, opened for a replay: the configuration that goes with its kind, and what may not be said of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.config import Config, ConfigError, load_config, preset
from sixthsense.sources.logs import LogError, is_bag, is_graph, is_mrclam, is_run_folder

if TYPE_CHECKING:
    from sixthsense.sources.logs.log import Log
    from sixthsense.sources.logs.relations import Relations

LOG_TIME_S = 1e6  # a log is replayed to its end

_OF_THE_ROBOT = ("scene", "task", "goal", "start", "region", "planner", "rrtstar", "follow", "explore", "world")


@dataclass(frozen=True, slots=True)
class Recorded:
    """A log with all that its replay needs."""

    name: str
    """of the file or folder"""
    log: Log
    """at its first tick"""
    config: Config
    """with the laser that the log describes, if it does"""
    relations: Relations | None
    """to measure the trajectory against"""
    files: Mapping[str, str]
    """what is replayed, by its role: `log`, and `relations` if there are any"""
    notes: tuple[str, ...]
    """a line each on what the user had better know of the log"""


def base_of(log: str | Path | None) -> str | Config:
    """What fields go over: a run's own configuration, the default robot for a bag, or the preset of the log's kind."""
    if log is None:
        return "intel"
    path = Path(log)
    if is_run_folder(path):
        return load_config(path / "config.toml")
    if is_bag(path):
        return preset(max_time=LOG_TIME_S)
    if is_graph(path):
        return "victoria"
    return "mrclam" if is_mrclam(path) else "intel"


def check_options(
    log: str | Path | None, fields: Mapping[str, Any], has_topics: bool, has_robot: bool, prefix: str = ""
) -> None:
    """Raise ConfigError for fields (nested, those that were given) and options that go with another kind of log.

    `prefix` stands before a field's name, as -- does on the command line.
    """
    robot = {f"robot.{name}" for name in fields.get("robot", {}) if name != "radius"}
    for name in (*_OF_THE_ROBOT, *sorted(robot)):
        if name in fields or name in robot:
            allowed = "options of what a log leaves open, not of the robot"
            raise ConfigError(f"{prefix}{name}: found on replay, allowed: {allowed}")
    if log is None:
        return
    path = Path(log)
    is_run = is_run_folder(path)
    if has_topics and (is_run or not is_bag(path)):
        raise ConfigError(f"{prefix}topic: found on a log that is no bag of ROS, allowed: on a bag")
    if is_run and "preset" in fields:
        raise ConfigError(f"{prefix}preset: found on the folder of a run, allowed: single fields over its config.toml")
    if is_run or is_bag(path):
        for name in fields.get("laser", {}):
            if name != "mount":
                allowed = f"allowed: {prefix}laser.mount"
                raise ConfigError(f"{prefix}laser.{name}: found on a bag, which describes its laser, {allowed}")
    _check_landmark_options(path, fields, has_robot, prefix)


def _check_landmark_options(path: Path, fields: Mapping[str, Any], has_robot: bool, prefix: str) -> None:
    """Raise ConfigError for options of what a log of landmarks known by name does not have."""
    graph = is_graph(path)
    mrclam = not graph and not is_run_folder(path) and not is_bag(path) and is_mrclam(path)
    if has_robot and not mrclam:
        raise ConfigError(f"{prefix}robot: found on a log that is no folder of MRCLAM, allowed: on one")
    if not graph and not mrclam:
        return
    for name in ("laser", "keyscans", "features", "grid", *(["assumed"] if graph else [])):
        for field_name in fields.get(name, {}):
            has = "states its own noise" if name == "assumed" else "has landmarks and no scans"
            raise ConfigError(f"{prefix}{name}.{field_name}: found on a log that {has}, allowed: on a log of scans")


def check_out(log: str | Path, out: Path | None) -> None:
    """Raise ConfigError for a folder to write that would cost the log itself."""
    if out is not None:
        partial = out.with_name((out.name or "run") + ".partial").resolve()
        path = Path(log).resolve()
        if partial in (path, *path.parents):
            raise ConfigError(f"--out: found {out}, whose .partial is the log itself, allowed: another folder")


def open_recorded(
    log: str | Path,
    config: Config,
    relations: str | Path | Relations | None = None,
    topics: Sequence[str] = (),
    robot: int | None = None,
) -> Recorded:
    """Open a log, and the relations to measure its replay against.

    Raises LogError for a file that cannot be made sense of, and for a relation that names no scan of the log.
    """
    from sixthsense.sources.logs import open_log
    from sixthsense.sources.logs.mrclam import MrclamLog
    from sixthsense.sources.logs.relations import read_relations
    from sixthsense.sources.logs.rosbag import BagLog

    files = {"log": str(Path(log).resolve())}
    if topics:
        files["topic"] = ",".join(topics)
    if robot is not None:
        files["robot"] = str(robot)
    from_file = isinstance(relations, (str, Path))
    if isinstance(relations, (str, Path)):
        files["relations"] = str(Path(relations).resolve())
        given: Relations | None = read_relations(relations)
    else:
        given = relations
    opened = open_log(log, config.laser, topics, robot, config.assumed)
    if given is not None:
        _check_relations(given, opened, str(relations) if from_file else "relations", log)
    notes = []
    if isinstance(opened, BagLog):
        config = dataclasses.replace(config, laser=opened.laser)
        if opened.cut_short:
            notes.append(f"its run was stopped; the {opened.duration_s:.1f} s of it are used")
    if isinstance(opened, MrclamLog) and opened.misread:
        notes.append(f"{opened.misread} measurements of no subject's barcode are passed over")
    if opened.backward_stamps:
        notes.append(f"stamps run backwards at {opened.backward_stamps} scans; replayed in file order")
    return Recorded(Path(log).resolve().name, opened, config, given, files, tuple(notes))


def _check_relations(relations: Relations, opened: Log, name: str, log: str | Path) -> None:
    """Raise LogError for a relation that names no scan of the log."""
    import numpy as np

    from sixthsense.sources.logs.relations import scan_rows

    stamps = np.array([t.log_stamp_s for t in opened.ticks if t.scan is not None], dtype=np.float64)
    try:
        scan_rows(stamps, relations.stamps)
    except ValueError as error:
        raise LogError(f"{name}: {error}, allowed: stamps of scans in {log}") from None
