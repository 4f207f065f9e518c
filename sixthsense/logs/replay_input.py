"""Input of a replay: an opened log with its configuration and relations, and checks of the options for its kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sixthsense.config import Config, load_config, merge
from sixthsense.config.errors import InputError
from sixthsense.config.files import absolute
from sixthsense.config.parts import OF_THE_ROBOT
from sixthsense.logs import kind_of, open_log
from sixthsense.logs.diagnose import settled
from sixthsense.logs.log import EXACT_S, Log, Relations, matched, passed_s, read_relations
from sixthsense.simulation.scene import Scene, load_scene

WITHOUT_ODOMETRY = "no odometry is used: each scan is predicted by the last velocity, and aligned with earlier scans"
"""note of a log, and line of a live run"""
_USED: Mapping[str, Sequence[str]] = {
    "carmen": ("laser.beams", "laser.fov", "laser.max_range", "laser.mount", "laser.mirrored", "laser.sweep_s"),
    "bag": ("topics", "odometry_frames", "laser.max_range", "laser.mount", "laser.mirrored"),
    "run": ("laser.mount",), "graph": (), "mrclam": ("robot",),
}  # fmt: skip
"""options that choose from a log or describe its laser, by the kind of log that has a use for them"""


class LogSelection(NamedTuple):
    """What is chosen of a log of several sensors or robots."""

    topics: Sequence[str] = ()
    """of a bag"""
    robot: int | None = None
    """of an MRCLAM folder"""
    odometry_frames: Sequence[str] = ()
    """parent and child of a bag's odometry in /tf"""

    def given(self) -> dict[str, str]:
        """What is chosen, as text by option."""
        values = {name: value for name, value in self._asdict().items() if value or value == 0}
        return {name: str(value) if name == "robot" else ",".join(value) for name, value in values.items()}


@dataclass(frozen=True, slots=True)
class ReplayInput:
    """An opened log with everything its replay needs."""

    name: str
    """name of the file or folder"""
    log: Log
    """the log, before its first tick"""
    config: Config
    """configuration, with the laser described by the log if it has one"""
    relations: Relations | None
    """reference for the trajectory"""
    files: Mapping[str, str]
    """inputs by role: `log`, and if given `relations`, `topics`, `odometry_frames` and `robot`"""
    notes: tuple[str, ...]
    """one-line notes on the log for the user"""


def recorded_scene(log: Log, config: Config) -> Scene | None:
    """The scene of a recorded simulated run; None for a log without truth, and where the scene's file is gone."""
    if log.ticks[0].truth is None or not log.scans:
        return None
    try:
        return load_scene(config.scene, config.map_unknown)
    except InputError:
        return None  # the record outlives the file


def base_of(log: str | Path | None) -> str | Config:
    """The base configuration for a log: that of the run folder, else the preset of its kind."""
    kind = "" if log is None else kind_of(Path(log))
    if log is not None and kind == "run":
        return load_config(Path(log) / "config.toml")
    return {"graph": "victoria", "mrclam": "mrclam"}.get(kind, "log")


def check_options(log: str | Path | None, fields: Mapping[str, Any], chosen: Iterable[str] = ()) -> None:
    """Raise InputError for given fields (nested) of the recorded robot, and for those that this log has no use for.

    `chosen` are the names of what is chosen of the log.
    """
    names = [*chosen]
    for name, value in fields.items():
        is_of_robot = name == "robot" and isinstance(value, Mapping) and value.keys() - {"radius"}
        if value and (name in OF_THE_ROBOT or is_of_robot):
            raise InputError(name, "found on replay", "options of the estimate, not of the recorded robot")
        names += [f"laser.{part}" for part in value] if name == "laser" and isinstance(value, Mapping) else []
    kind = kind_of(Path(log)) if names and log is not None else ""
    for name in names:
        if kind and name not in _USED[kind]:
            allowed = ", ".join(map("`{}`".format, _USED[kind]))
            raise InputError(name, f"found on a log of kind {kind}", allowed or "no option of a laser")


def check_out(log: str | Path, out: Path | None) -> None:
    """Raise InputError for an output folder that would overwrite the log."""
    if out is not None:
        partial, path = absolute(out.with_name((out.name or "run") + ".partial")), absolute(log)
        if partial in (path, *path.parents):
            raise InputError("out", f"found {out}, whose .partial is the log itself", "another folder")


def open_recorded(
    log: str | Path, config: Config, relations: str | Path | Relations | None = None, chosen: LogSelection | None = None
) -> ReplayInput:
    """Open a log, and the relations to evaluate its replay; relations with a stamp that no scan has are left out.

    Fields of `config.laser` that were stated take precedence over the log. Raises InputError for an invalid file, and
    for relations none of which has stamps of scans.
    """
    chosen = chosen or LogSelection()
    files = {"log": str(absolute(log)), **chosen.given()}
    if isinstance(relations, (str, Path)):
        files["relations"] = str(absolute(relations))
    opened = open_log(log, config.laser, *chosen[:2], config.assumed, chosen.odometry_frames, not config.no_odometry)
    return of_opened(opened, config, relations, absolute(log).name, files)


def of_opened(
    log: Log,
    config: Config,
    relations: str | Path | Relations | None,
    name: str = "log",
    files: Mapping[str, str] | None = None,
) -> ReplayInput:
    """The input of a replay from a log that is open, with what is found out about it applied and noted.

    Raises InputError for a log that cannot be right, and as `relations_of`.
    """
    log, config, findings = settled(log, config, name)
    notes: list[str] = []
    if relations is not None:
        read = read_relations(relations) if isinstance(relations, (str, Path)) else relations
        relations = relations_of(log, read, "relations" if read is relations else str(relations), notes)
    notes += map(str, findings)
    if closures := sum(len(tick.closures or ()) for tick in log.ticks):
        used = "used" if config.estimator == "isam2" else f"left out: {config.estimator} keeps no poses, isam2 does"
        notes.append(f"{closures} edges between earlier poses are loop closures, and are {used}")
    config = of_log(config, log)
    if config.no_odometry:
        stamps = [tick.stamp_ns for tick in log.ticks if tick.scan is not None]
        if np.isinf(passed_s(stamps)).any():
            raise InputError(name, "found scans whose stamps tell no time", "without odometry, stamps that do")
        notes.append(WITHOUT_ODOMETRY)
    return ReplayInput(name, log, config, relations, files or {}, tuple(notes))


def of_log(config: Config, log: Log) -> Config:
    """The configuration with the laser as the log describes it, if it does, and without odometry if it has none."""
    config = config if log.has_odometry else merge(config, {"no_odometry": True})
    return config if log.laser is None else config.replaced(laser=log.laser)


def relations_of(log: Log, relations: Relations, name: str, notes: list[str]) -> Relations:
    """The relations between scans of a log, with the stamps of these; how many there are is said in `notes`.

    The scan of a stamp is the nearest within half a period. Raises InputError where no relation is left.
    """
    stamps = np.array([t.log_stamp_s for t in log.ticks if t.log_stamp_s is not None], dtype=np.float64)
    rows = matched(stamps, relations.stamps)
    known = (rows >= 0).all(axis=1) & ((rows[:, 0] != rows[:, 1]) | (relations.stamps[:, 0] == relations.stamps[:, 1]))
    if not known.any():
        found = f"found no relation between scans of the log (the first is of {relations.stamps[0, 0]:.6f})"
        raise InputError(name, found, "stamps of scans of the log")
    of_scans = stamps[rows[known]]
    off_s = float(np.abs(of_scans - relations.stamps[known]).max())
    if not known.all() or off_s > EXACT_S:
        count = np.count_nonzero(known)
        text = f"{count} of {len(known)} relations are of scans, {off_s:.3g} s away at most"
        notes.append(f"{text}; {len(known) - count} name stamps of no scan and are left out")
    return Relations(of_scans, relations.poses[known])
