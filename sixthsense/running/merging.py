"""Two runs in one building as one log: the second goes on where it is found in the map of the first."""

from __future__ import annotations

import dataclasses
import logging
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sixthsense.config import Config, load_config, merge
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick
from sixthsense.figures.run import Run
from sixthsense.logs.log import Log
from sixthsense.logs.replay_input import ReplayInput, open_recorded
from sixthsense.record.folder import RunFolder
from sixthsense.record.store import load_record
from sixthsense.running.runs import RunHooks, replay_log
from sixthsense.slam.prior_map import KeyScans
from sixthsense.slam.relocalization import Relocalizer
from sixthsense.slam.slam import Slam
from sixthsense.verdict.evidence import contradicted_between

_SIGMA_M, _SIGMA_RAD = 0.3, 0.1  # of the place where the second run is found
_DRIFT_M_PER_M, _DRIFT_RAD_PER_M = 0.02, 0.002  # of the way from its begin until there
_MOST_CONTRADICTED = 0.07  # share beyond that within a run; 0.03 where two cupboards were moved by a metre meanwhile
_PAUSE_NS = 1_000_000_000  # between the runs, where the second was recorded earlier

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Merged(ReplayInput):
    """Two runs as one log."""

    begin_ns: int
    """stamp of the second run's first tick"""


def open_merged(first: Path, second: Path, config: Config) -> Merged:
    """The folders of two runs as one log, by the configuration of the first. Raises what `merged_log` raises.

    Scans are aligned, whatever front end and estimator it names. Raises InputError for a run with itself, and for one
    whose own map is broken.
    """
    if first.resolve() == second.resolve():
        raise InputError(second, "found the first run again, whose scans would count twice", "another run")
    _log.info(f"looking for {second} in the map of {first}")
    for run in (first, second):
        verdict = load_record(run).trace.verdict
        if verdict is not None and verdict.level == "broken":
            raise InputError(run, f"found a map that is {verdict}", "one that is good")
    aligning = {"front_end": "scan-matching", "estimator": "isam2", "calibrate_wheels": False, "max_time": None}
    settings = ((first, config), (second, load_config(second / "config.toml")))
    return merged_log(*(open_recorded(run, merge(own, aligning)) for run, own in settings))


def merged_log(first: ReplayInput, second: ReplayInput) -> Merged:
    """The ticks of both runs; raises InputError if the second is found nowhere in the first.

    The second run is mapped by itself, and what it has seen on its last metres is searched for in the map of the first,
    until it fits one place alone. The step from the end of the first run to the begin of the second has the covariance
    of that place; no wheel has measured it.
    """
    _check_lasers(first, second)
    with Slam(first.config, first.log.start) as slam:
        steps = [slam.take(tick) for tick in first.log.ticks]
        end, scans = slam.pose, [step.scan for step in steps if step.keyframe is not None and step.scan is not None]
        relocalizer = Relocalizer(KeyScans(scans, slam.finish().trajectory), first.config)
    with Slam(first.config, Pose()) as slam:
        begin = _begin(slam, second.log.ticks, relocalizer)
    if begin is None:
        found = f"found no place of {first.name} that alone fits what was seen"
        raise InputError(second.name, found, "two runs that share a part of one building, in which places differ")
    driven_m = relocalizer.driven_m
    sigmas = np.array([_SIGMA_M + _DRIFT_M_PER_M * driven_m] * 2 + [_SIGMA_RAD + _DRIFT_RAD_PER_M * driven_m])
    ticks = (*first.log.ticks, *_going_on(first.log.ticks[-1], second.log.ticks, end.inverse() @ begin, sigmas))
    notes = tuple(f"{run.name}: {note}" for run in (first, second) for note in run.notes)
    files = {"log": first.files["log"], "merged_with": second.files["log"]}
    name, log = f"{first.name}-{second.name}", Log(ticks, first.log.laser)
    return Merged(name, log, first.config, None, files, notes, ticks[len(first.log.ticks)].stamp_ns)


def replay_merged(merged: Merged, folder: RunFolder | None, watch: RunHooks) -> Run:
    """Replay a merged log, as `replay_log`; raises InputError if the second run could not be linked to the first.

    That is also raised if the runs contradict each other. Nothing is left of the folder then.
    """

    def check(run: Run) -> None:
        trace = run.trace
        if trace.outcome == "interrupted":
            if (verdict := trace.verdict) is not None and verdict.level == "good":
                trace.verdict = dataclasses.replace(verdict, level="unjudged", probability=None, reason="interrupted")
            return
        first = np.searchsorted(trace.key_stamps_ns, merged.begin_ns)
        links = 0 if trace.links is None else int(((trace.links.ends < first).sum(axis=1) == 1).sum())
        if not links:
            raise InputError("merge", "found no scan that could be linked to the first run", "two runs of one building")
        if trace.verdict is not None and trace.verdict.level == "broken":
            raise InputError("merge", f"found a map that is {trace.verdict} ({links:,} links)", "runs that agree")
        between, own = contradicted_between(trace.witnesses(), int(first))
        if between - own > _MOST_CONTRADICTED:
            found = f"found that {between:.0%} of what one run saw the other contradicts, and itself {own:.0%}"
            raise InputError("merge", found, "two runs in one building, not in one and its mirror image")
        _log.info(f"note: {links:,} links join both runs")

    try:
        return replay_log(merged, folder, dataclasses.replace(watch, at_end=check))
    except InputError:
        if folder is not None:
            shutil.rmtree(folder.partial, ignore_errors=True)
        raise


def _check_lasers(first: ReplayInput, second: ReplayInput) -> None:
    for run in (first, second):
        if not run.log.scans:
            raise InputError(run.name, "found a run without scans", "runs with scans")
    one, other = first.config.laser, second.config.laser
    for name in ("beams", "fov"):
        if not np.isclose(getattr(one, name), getattr(other, name)):
            allowed = f"{getattr(one, name):g}, as in {first.name}"
            raise InputError(second.name, f"found laser.{name} {getattr(other, name):g}", allowed)


def _begin(slam: Slam, ticks: Sequence[Tick], relocalizer: Relocalizer) -> Pose | None:
    """Where a run begins in the map, once a place of it is certain; None if none ever is."""
    for tick in ticks:
        step = slam.take(tick)
        if step.scan is not None and (found := relocalizer.take(step.scan, step.pose)) is not None:
            return found
    return relocalizer.place


def _going_on(last: Tick, ticks: Sequence[Tick], motion: Pose, sigmas: Array) -> Iterator[Tick]:
    """The ticks of the second run, after `last`, in the odometry frame of the first, with ascending stamps."""
    T_first_second = last.odometry @ motion @ ticks[0].odometry.inverse()
    later_ns = max(0, last.stamp_ns + _PAUSE_NS - ticks[0].stamp_ns)
    for k, tick in enumerate(ticks):
        cov = np.diag(sigmas**2) if k == 0 else tick.increment_cov
        yield dataclasses.replace(
            tick, stamp_ns=tick.stamp_ns + later_ns, odometry=T_first_second @ tick.odometry, increment_cov=cov
        )
