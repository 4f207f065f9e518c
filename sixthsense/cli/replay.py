"""`sixthsense replay`."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from sixthsense.cli.common import (
    Common,
    Progress,
    announce_compilation,
    each,
    finish,
    parse_command,
    run_folder,
    show_help,
    wants_help,
)
from sixthsense.cli.options import Table, UsageError
from sixthsense.config import Config, load_config, preset

if TYPE_CHECKING:
    from sixthsense.logs.log import Log
    from sixthsense.logs.relations import Relations

LOG_TIME_S = 1e6  # a log is replayed to its end


@dataclass(frozen=True)
class Replay(Common):
    """Digest a recorded log.

    CARMEN (.log, .clf) or a graph of landmarks (.graph, .g2o, .toro, .txt), plain, .gz or .bz2; a ROS 1 or ROS 2 bag;
    the folder of a run; a folder of MRCLAM.
    """

    log: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")] = None
    """The log."""
    relations: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Hand-checked relations between poses (Kuemmerle et al. 2009) to measure the trajectory against."""
    topic: Annotated[str | None, tyro.conf.arg(metavar="NAME[,NAME]")] = None
    """Topics of a bag to use, where it has several of scans or of odometry."""
    robot: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Robot of a MRCLAM folder to follow, where it has several."""


def command(args: list[str]) -> int:
    """Replay a log."""
    if wants_help(args):
        return show_help(Replay, "replay", "intel")
    options, flags = parse_command(Replay, "log", _replay_base, args)
    config = options.settings
    robot = {f"robot.{name}" for name in flags.get("robot", {}) if name != "radius"}
    for name in (
        "scene",
        "task",
        "goal",
        "start",
        "region",
        "planner",
        "rrtstar",
        "follow",
        "explore",
        "world",
        *sorted(robot),
    ):
        if name in flags or name in robot:
            raise UsageError(f"--{name}: found on replay, allowed: options of what a log leaves open, not of the robot")
    if options.log is None:
        raise UsageError("log: found nothing, allowed: a CARMEN file, a graph, a bag, the folder of a run or of MRCLAM")
    _check_bag_options(options, flags)
    _check_landmark_options(options, flags)
    from sixthsense.bag import BagWriter
    from sixthsense.logs import open_log
    from sixthsense.logs.mrclam import MrclamLog
    from sixthsense.logs.relations import read_relations
    from sixthsense.logs.rosbag import BagLog
    from sixthsense.loop import replay, warm_up

    relations = read_relations(options.relations) if options.relations is not None else None
    topics = options.topic.split(",") if options.topic else ()
    log = open_log(options.log, config.laser, topics, options.robot, config.assumed)
    if relations is not None:
        _check_relations(relations, log, options)
    name = Path(options.log).resolve().name
    if isinstance(log, BagLog):
        config = dataclasses.replace(config, laser=log.laser)
        if log.cut_short:
            print(f"note: {name}: its run was stopped; the {log.duration_s:.1f} s of it are used", file=sys.stderr)
    if isinstance(log, MrclamLog) and log.misread:
        print(f"note: {name}: {log.misread} measurements of no subject's barcode are passed over", file=sys.stderr)
    if log.backward_stamps:
        note = f"note: {name}: stamps run backwards at {log.backward_stamps} scans; replayed in file order"
        print(note, file=sys.stderr)
    replayed = {"log": str(Path(options.log).resolve())}
    if options.relations is not None:
        replayed["relations"] = str(options.relations.resolve())
    with run_folder(options, config, f"{name.split('.')[0]}-{config.estimator}", replayed) as folder:
        announce_compilation()
        warm_up()
        with BagWriter(folder.partial) as bag, Progress(name, log.duration_s, False) as progress:
            trace = replay(log, config, relations, each(bag, progress))
        return finish(folder, trace, f"{name} · {config.estimator}: {trace.outcome}")


def _replay_base(log: str | None) -> str | Config:
    """What flags go over: a run's own configuration, the default robot for a bag, or the preset of the log's kind."""
    from sixthsense.logs import is_bag, is_graph, is_mrclam, is_run_folder

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


def _check_bag_options(options: Replay, flags: Table) -> None:
    """Raise UsageError for options that go with another kind of log, or that would cost the log itself."""
    from sixthsense.logs import is_bag, is_run_folder

    path = Path(options.log or "")
    if options.topic is not None and (is_run_folder(path) or not is_bag(path)):
        raise UsageError("--topic: found on a log that is no bag of ROS, allowed: on a bag")
    if is_run_folder(path) and "preset" in flags:
        raise UsageError("--preset: found on the folder of a run, allowed: single fields over its config.toml")
    if is_run_folder(path) or is_bag(path):
        for field_name in flags.get("laser", {}):
            if field_name != "mount":
                raise UsageError(
                    f"--laser.{field_name}: found on a bag, which describes its laser, allowed: --laser.mount"
                )
    if options.out is not None:
        partial = options.out.with_name((options.out.name or "run") + ".partial").resolve()
        if partial in (path.resolve(), *path.resolve().parents):
            raise UsageError(f"--out: found {options.out}, whose .partial is the log itself, allowed: another folder")


def _check_landmark_options(options: Replay, flags: Table) -> None:
    """Raise UsageError for options of what a log of landmarks known by name does not have."""
    from sixthsense.logs import is_bag, is_graph, is_mrclam, is_run_folder

    path = Path(options.log or "")
    graph = is_graph(path)
    mrclam = not graph and not is_run_folder(path) and not is_bag(path) and is_mrclam(path)
    if options.robot is not None and not mrclam:
        raise UsageError("--robot: found on a log that is no folder of MRCLAM, allowed: on one")
    if not graph and not mrclam:
        return
    for name in ("laser", "keyscans", "features", "grid", *(["assumed"] if graph else [])):
        for field_name in flags.get(name, {}):
            has = "states its own noise" if name == "assumed" else "has landmarks and no scans"
            raise UsageError(f"--{name}.{field_name}: found on a log that {has}, allowed: on a log of scans")


def _check_relations(relations: Relations, log: Log, options: Replay) -> None:
    """Raise UsageError for a relation that names no scan of the log."""
    import numpy as np

    from sixthsense.metrics import relations_error

    stamps = np.array([t.log_stamp_s for t in log.ticks if t.scan is not None], dtype=np.float64)
    try:
        relations_error(stamps, np.zeros((len(stamps), 3)), relations.stamps, relations.poses)
    except ValueError as error:
        raise UsageError(f"{options.relations}: {error}, allowed: stamps of scans in {options.log}") from None
