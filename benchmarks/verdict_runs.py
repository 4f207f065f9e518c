"""Runs with a right and with a wrong map, from which the verdict is fitted, and others on which it is judged.

Pieces of recorded logs and drives in generated worlds, each as it is and damaged. The true poses of a piece of a log
are those of the whole log, mapped as it is with the defaults: they are centimetres from the hand-checked relations.
What is kept of a run is what the verdict looks at, and the errors of its poses.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from damaged_logs import DAMAGES
from repetition_scenes import SCENES, log_of
from runs import data_path, replay
from worlds import world
from wrong_logs import WRONG, changed

from sixthsense.config import Config, merge, preset
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan
from sixthsense.core.random_streams import random_streams
from sixthsense.core.se2 import between
from sixthsense.core.source import Command, Tick
from sixthsense.logs.log import Log
from sixthsense.logs.replay_input import ReplayInput, of_log, open_recorded
from sixthsense.simulation.world import World
from sixthsense.slam.front_end import LoopClosureCounts
from sixthsense.verdict.witnesses import Witnesses

PIECES = {
    "fit": {"intel": ((150, 100), (1000, 100), (2300, 100)), "fr079": ((60, 100), (700, 100))},
    "judge": {"aces": ((60, 100), (500, 100), (1000, 100)), "clinic": ((200, 300), (3300, 300))},
}
"""by half and log, begin and length of each piece, s"""
WORLDS = {
    "fit": (("bends", 1), ("doors", 4)),
    "judge": (("steps", 5), ("curves", 6)),
}
ALIKE = {"fit": (1, 2), "judge": (3, 4)}
"""seeds of drives through equal rooms, with a laser that sees little more than one"""
_ALIKE_M = 3.5
_EVERY = {"intel": 2, "fr079": 2, "aces": 2, "clinic": 1}
"""of the scans of a log, each of which is used"""
SEEDS = {"fit": 1, "judge": 2}
FILES = {
    "intel": "intel/intel.clf.bz2",
    "fr079": "fr079/fr079.clf.bz2",
    "aces": "aces/aces.clf.bz2",
    "clinic": "clinic/clinic.bag",
}
_MOST_PIECES = {"intel": 2, "fr079": 1, "aces": 2, "clinic": 1}
"""pieces of a log that all of `WRONG` is done to; one has the other damages"""
_OF_EVEN_BEAMS = ("blanks", "people", "rough")
"""damages of logs whose scans have the same beams"""
_OF_WORLDS = ("clean", "people", "rough", *WRONG)
_WORLD_S, _WORLD_SPEED = 120.0, 0.5


class Source(NamedTuple):
    """Ticks with scans, where the robot truly was, and the configuration to replay them with."""

    ticks: list[Tick]
    truth: Array
    laser: Any
    config: Config


def jobs(half: str) -> Iterator[tuple[str, str, str]]:
    """Source, front end and damage of each run of a half."""
    for seed in ALIKE[half]:
        yield f"alike-{seed}", "scan-matching", "clean"
    for damage in ("clean", *WRONG, *(name for name in DAMAGES if name != "clean")):
        for log, pieces in PIECES[half].items():
            if log == "clinic" and damage in _OF_EVEN_BEAMS:
                continue
            for k in range(_MOST_PIECES[log] if damage in WRONG else len(pieces) if damage == "clean" else 1):
                yield f"{log}-{k}", "scan-matching", damage
        if damage in _OF_WORLDS:
            for k, (family, seed) in enumerate(WORLDS[half]):
                for front in ("scan-matching", "landmarks")[: 1 if k and damage != "clean" else 2]:
                    yield f"{family}-{seed}", front, damage


def source(half: str, name: str, cache: Path) -> Source:
    """A piece of a log, or a drive in a world."""
    what, _, number = name.rpartition("-")
    if what == "alike":
        return _alike(int(number))
    if what not in FILES:
        return _driven(what, int(number))
    begin_s, length_s = PIECES[half][what][int(number)]
    recorded = _opened(what)
    ticks = [tick for tick in recorded.log.ticks if tick.scan is not None]
    file = cache / f"truth-{what}.npy"
    if not file.exists():
        np.save(file, replay(Log(ticks, recorded.log.laser), recorded.config).trace.scan_poses())
    truth, stamps_s = np.load(file), 1e-9 * np.array([tick.stamp_ns for tick in ticks])
    own = (stamps_s >= stamps_s[0] + begin_s) & (stamps_s < stamps_s[0] + begin_s + length_s)
    rows = np.flatnonzero(own)[:: _EVERY[what]]
    return Source([ticks[k] for k in rows], truth[rows], recorded.log.laser, recorded.config)


@functools.cache
def _opened(log: str) -> ReplayInput:
    return open_recorded(data_path(FILES[log]), preset("log"))


def _driven(family: str, seed: int) -> Source:
    """A drive along a tour by commands, in a generated world."""
    config = merge(preset("default"), {"seed": seed, "laser": {"beams": 360, "max_range": 10.0}})
    scene = world(family, seed, _WORLD_S, _WORLD_SPEED)
    assert scene.start is not None and scene.tour is not None
    drive = World(scene.walls, scene.start, scene.radius or DEFAULT_ROBOT_RADIUS_M, config, random_streams(seed).world)
    scans: list[Tick] = []
    goals, command = [*scene.tour], Command()
    for _ in range(round(_WORLD_S / config.robot.control_period_s)):
        tick = drive.step(command)
        if tick is None or tick.collided or not goals:
            break
        assert tick.truth is not None
        if tick.scan is not None:
            scans.append(tick)
        x, y = goals[0][0] - tick.truth.x, goals[0][1] - tick.truth.y
        if math.hypot(x, y) < 0.1:
            goals.pop(0)
        turn = (math.atan2(y, x) - tick.truth.theta + math.pi) % (2.0 * math.pi) - math.pi
        command = Command(config.robot.speed * max(0.0, 1.0 - 3.0 * abs(turn)), float(np.clip(3.0 * turn, -1.0, 1.0)))
    ticks = scans[::2]
    return Source(ticks, np.array([tick.truth.array() for tick in ticks if tick.truth]), config.laser, config)


def _alike(seed: int) -> Source:
    """A drive through equal rooms."""
    rooms = SCENES["rooms"]
    log = log_of(rooms._replace(laser=rooms.laser.replaced(max_range=_ALIKE_M)), seed)
    truth = np.array([tick.truth.array() for tick in log.ticks if tick.truth])
    return Source(log.ticks, truth, log.laser, preset("log"))


def made(src: Source, front: str, damage: str, seed: int) -> dict[str, Any]:
    """The run of a damaged source: its witnesses and true poses, flat."""
    ticks, truth = changed(damage, [dataclasses.replace(tick, truth=None) for tick in src.ticks], src.truth, seed)
    base = src.config
    if front == "scan-matching" and base.front_end != front:
        base = preset("log")
    log = Log(ticks, None)
    config = base.replaced(laser=src.laser) if src.laser is not None else base
    began = time.process_time()
    trace = replay(log, of_log(config, log)).trace
    spent = time.process_time() - began
    return {**packed(trace.witnesses()), "truth": truth, "seconds": spent}


def packed(found: Witnesses) -> dict[str, Any]:
    """Witnesses as arrays."""
    out = {name: getattr(found, name) for name in found.__dataclass_fields__ if name != "scans"}
    scans = found.scans or [None] * len(found.trajectory)
    beams = max((len(scan.ranges) for scan in scans if scan is not None), default=1)
    ranges, frames = np.full((len(scans), beams), np.nan, np.float32), np.zeros((len(scans), 7))
    for k, scan in enumerate(scans):
        if scan is not None:
            ranges[k, : len(scan.ranges)] = scan.ranges
            frames[k] = (
                len(scan.ranges),
                scan.angle_min,
                scan.angle_increment,
                scan.max_range,
                *scan.T_robot_laser.array(),
            )
    return {name: value for name, value in out.items() if value is not None} | {"ranges": ranges, "frames": frames}


def unpacked(arrays: dict[str, Any]) -> Witnesses:
    """Witnesses from arrays."""
    from sixthsense.core.geometry import Pose

    scans: list[Scan | None] = []
    for ranges, (beams, first, spacing, most, *at) in zip(arrays["ranges"], arrays["frames"], strict=True):
        own = None if not beams else Scan(ranges[: int(beams)], np.float32(first), np.float32(spacing), most, Pose(*at))
        scans.append(own)
    names = [name for name in Witnesses.__dataclass_fields__ if name != "scans"]
    given = {name: arrays.get(name) for name in names}
    if given["closures"] is not None:
        given["closures"] = LoopClosureCounts(*given["closures"].tolist())
    return Witnesses(**given, scans=tuple(scans) if arrays["frames"][:, 0].any() else ())


def errors(poses: Array, truth: Array, seed: int = 0) -> tuple[Array, Array]:
    """Errors, m and rad, of relations between scans: half of pairs less than 10 m of way apart, half of any."""
    rng, n = np.random.default_rng(seed), len(truth)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    first = rng.integers(0, n, 600)
    second = rng.integers(0, n, 600)
    near = np.searchsorted(way, way[first[:300]] + rng.uniform(0.5, 10.0, 300))
    second[:300] = np.minimum(near, n - 1)
    off = between(between(truth[first], truth[second]), between(poses[first], poses[second]))
    return np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
