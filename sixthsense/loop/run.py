"""The loop, from sensor data to command: a simulated world and a log drive the same `Slam`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.config.tree import naming_parts
from sixthsense.core.geometry import Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Command, Source, Tick
from sixthsense.logs.log import Log, Playback, Relations
from sixthsense.logs.replay_input import recorded_scene
from sixthsense.loop.interrupt import deferred_interrupt
from sixthsense.navigation import make_navigator
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.trace import Live, Stopwatch, Trace
from sixthsense.simulation.mission import Mission, mission_of
from sixthsense.simulation.scene import Scene
from sixthsense.slam.prior_map import PriorStart, check_usable
from sixthsense.slam.result import Step
from sixthsense.slam.slam import Slam
from sixthsense.verdict.judge import judge

OnTick = Callable[[Tick, Trace], None]
"""Hook of a caller: called after every tick with it and the record so far."""

NOWHERE = "nowhere"
"""outcome of a search for the start that has driven far enough"""

Watcher = Callable[[Tick, Step, Command], str | None]
"""Called after every tick; an outcome that it returns ends the run."""


def drive(source: Source, slam: Slam, pilot: Pilot, watchers: Sequence[Watcher], clock: Stopwatch) -> str:
    """Run until the task is over, a watcher ends it, or the source has no more ticks; returns the outcome.

    Raises PartError that names a part which is not shipped, if it fails.
    """
    command, keyframe, first_ns = Command(), -1, None
    while True:
        with clock.stage("sense"):
            tick = source.step(command)
        if tick is None:
            return "log ended"
        first_ns = tick.stamp_ns if first_ns is None else first_ns
        when = f"after keyframe {keyframe}, at {1e-9 * (tick.stamp_ns - first_ns):.2f} s"
        with naming_parts(slam.config, when, slam.check_estimate):
            step = slam.take(tick)
            keyframe = keyframe if step.keyframe is None else step.keyframe.index
            with clock.stage("plan"):
                command = pilot.steer(step)
        outcome: str | None = "collided" if tick.collided else pilot.navigator.outcome
        for watch in watchers:
            ended = watch(tick, step, command)
            outcome = outcome or ended
        if outcome is not None:
            return outcome


def combined_hooks(*hooks: OnTick | None) -> OnTick:
    """Several hooks of the loop as one; None is left out."""

    def call(tick: Tick, trace: Trace) -> None:
        for hook in filter(None, hooks):
            hook(tick, trace)

    return call


def _ends(config: Config, timeout_outcome: str, interrupted: Callable[[], bool]) -> Watcher:
    """A watcher that ends a run when its time by the source's clock is over, and when it is interrupted."""
    end_ns: int | None = None

    def watch(tick: Tick, step: Step, command: Command) -> str | None:
        nonlocal end_ns
        if end_ns is None and config.max_time is not None:
            end_ns = tick.stamp_ns + round(config.max_time * 1e9)
        is_late = end_ns is not None and tick.stamp_ns >= end_ns
        return timeout_outcome if is_late else "interrupted" if interrupted() else None

    return watch


def recorder(trace: Trace, slam: Slam, pilot: Pilot) -> Watcher:
    """A watcher that appends what each tick brought to a trace, which shows the plans and the map from now on."""
    trace.plans, trace.tours, trace.grid = pilot.navigator.plans, pilot.navigator.tours, slam.grid
    live = trace.live = Live(slam.estimator, slam.associator.records, slam.draw_map, slam.mapper)
    is_measured = has_wheels = not trace.config.no_odometry

    def record(tick: Tick, step: Step, command: Command) -> None:
        nonlocal is_measured
        keyframe = step.keyframe
        trace.stopwatch.end_tick(keyframe is not None)
        is_carried = step.increment is not None and step.increment.is_carried()
        is_measured &= not (tick.is_unmeasured or is_carried)
        live.scan, live.since_cov = step.scan or live.scan, step.since.cov
        if keyframe is not None:
            live.features = keyframe.features
            trace.add_keyframe(tick, keyframe, step.scan, is_measured)
            is_measured = has_wheels
        trace.add_tick(tick, step.dead_reckoned, is_carried)
        if tick.scan is not None or tick.observations is not None:
            trace.add_scan(tick, step)

    return record


def finish(trace: Trace, slam: Slam, pilot: Pilot, outcome: str) -> None:
    """Record how a run ended, and what is known then."""
    navigator = pilot.navigator
    trace.outcome, trace.live, trace.left = outcome, None, navigator.left
    if navigator.plans_below_margin is not None:
        trace.guard_stops, trace.plans_below_margin = pilot.guard.stops, navigator.plans_below_margin
        trace.plans_by_astar = navigator.plans_by_astar
    result = slam.finish()
    trace.final, trace.joint_cov, trace.trajectory = result.estimate, result.joint_cov, result.trajectory
    if trace.config.no_odometry:  # no wheels have counted the way
        trace.path_length_m = float(np.hypot(*np.diff(result.trajectory[:, :2], axis=0).T).sum())
    trace.records = dict(result.landmark_records)
    trace.culled, trace.walls_merged = result.culled, result.walls_merged
    trace.loop_closures, trace.links = result.loop_closures, result.links
    trace.wheels = None if result.wheels is None else result.wheels.with_sigmas()
    trace.sensor = None if result.sensor is None else result.sensor.with_sigmas()
    if result.since_key is not None:
        trace.since_key = list(result.since_key)
    trace.verdict = judge(trace.witnesses())


def run(
    config: Config, on_tick: OnTick | None = None, scene: Scene | Mission | None = None, prior: PriorStart | None = None
) -> Trace:
    """Simulate `config.scene` and drive its task.

    `scene` is that scene where it is loaded already, or the mission there where it has been checked, which is that of
    one run alone. `on_tick` is called after every tick with it and the trace so far.
    With `prior` the robot begins with the map of an earlier run; the true start is that of scene and configuration.
    Ctrl-C ends the run in order, as "interrupted". Raises InputError for an invalid scene, start or goal, and
    for a prior map that cannot be used.
    """
    if not isinstance(scene, Mission):
        config, scene = mission_of(config, scene)
    source: Source = scene.world(config)
    scene, start, goals, radius_m, _ = scene
    streams = random_streams(config.seed)
    region = config.region or scene.region
    believed = start if prior is None or prior.pose is None else prior.pose
    if prior is not None and prior.is_lost:
        source, prior, believed = find_start(source, config, radius_m, prior, searching_navigator(config, radius_m))
    navigator = make_navigator(config, believed, goals, region, radius_m, streams.planner, streams.exploration)
    pilot = Pilot(navigator, Guard(config, radius_m))
    return recorded_drive(source, start, pilot, Trace(config, scene, radius_m, name=scene.name), on_tick, prior)


def replay(
    log: Log,
    config: Config,
    relations: Relations | None = None,
    on_tick: OnTick | None = None,
    prior: PriorStart | None = None,
) -> Trace:
    """Process a recorded log with the same loop; no command is used.

    With `relations` the metrics compare the trajectory with them. A recorded run has its truth in the log, and its
    scene, if that still loads, in `config`. `prior` is as of `run`.
    """
    scene = recorded_scene(log, config)
    radius_m = config.robot.radius or (DEFAULT_ROBOT_RADIUS_M if scene is None else scene.radius)
    trace = Trace(config, scene, radius_m, relations=relations, name="log" if scene is None else scene.name)
    source: Source = Playback(log.ticks)
    if prior is not None and prior.is_lost:
        source, prior, _ = find_start(source, config, radius_m, prior, Navigator())
    pilot = Pilot(Navigator(), Guard(config, radius_m))
    return recorded_drive(source, log.start, pilot, trace, on_tick, prior)


def find_start(
    source: Source, config: Config, radius_m: float, prior: PriorStart, navigator: Navigator
) -> tuple[Source, PriorStart, Pose]:
    """Drive without the map until the robot's place in it is certain: the source from its begin, and the start.

    Raises InputError if nothing has become certain when the drive ends, at the latest after `config.max_time`.
    """
    from sixthsense.slam.relocalization import FOUND_SIGMA, MOST_DRIVEN_M, Relocalizer  # only lost robots need it

    check_usable(prior.map, config)
    relocalizer, start = Relocalizer(prior.map.scans, config), None
    driven: list[Tick] = []

    def search(tick: Tick, step: Step, command: Command) -> str | None:
        nonlocal start
        driven.append(tick)
        if step.scan is not None:
            start = relocalizer.take(step.scan, step.pose)
        return NOWHERE if relocalizer.driven_m > MOST_DRIVEN_M else None if start is None else "located"

    pilot, clock = Pilot(navigator, Guard(config, radius_m)), Stopwatch()
    drives = navigator.plans_below_margin is not None
    with (
        Slam(config, Pose(), radius_m=radius_m, clock=clock.stage, draws_map=drives) as slam,
        deferred_interrupt() as interrupted,
    ):
        outcome = drive(source, slam, pilot, [search, _ends(config, "out of time", interrupted)], clock)
    if outcome == "interrupted":
        raise KeyboardInterrupt
    if outcome in ("explored", "explored in part", "log ended"):  # no more will be seen
        start = relocalizer.place
    if start is None:
        found = f"found no place of {prior.map.name} that alone fits what was seen on {relocalizer.driven_m:.0f} m"
        raise InputError("lost", f"{found} ({outcome})", "a map of this building, in which places differ")
    return Playback(driven, source), prior._replace(pose=start, sigma=FOUND_SIGMA), start


def searching_navigator(config: Config, radius_m: float) -> Navigator:
    """The navigator of a robot that explores, since goals and a region mean nothing to it while it is lost."""
    from sixthsense.slam.relocalization import MOST_DRIVEN_M

    streams, reach_m = random_streams(config.seed), 2.0 * MOST_DRIVEN_M
    task = config.replaced(task="explore", goal=None, tour=None)
    region = (-reach_m, -reach_m, reach_m, reach_m)
    return make_navigator(task, Pose(), np.zeros((0, 2)), region, radius_m, streams.planner, streams.exploration)


def recorded_drive(
    source: Source,
    start: Pose,
    pilot: Pilot,
    trace: Trace,
    on_tick: OnTick | None = None,
    prior: PriorStart | None = None,
) -> Trace:
    """Run the loop with recorder, hook, deadline and interrupt as watchers, and return the record."""
    config, clock = trace.config, trace.stopwatch
    with _slam(start, trace, pilot, prior) as slam:
        record, began = recorder(trace, slam, pilot), time.perf_counter()
        with deferred_interrupt() as interrupted:
            shown: list[Watcher] = [] if on_tick is None else [lambda tick, step, command: on_tick(tick, trace)]
            watchers = [record, *shown, _ends(config, pilot.navigator.timeout_outcome, interrupted)]
            outcome = drive(source, slam, pilot, watchers, clock)
            if interrupted() and not trace.stamps_ns:  # a run without a scan replaces no other
                raise KeyboardInterrupt
            # A robot that sends nothing brings no tick after which a watcher could end the run.
            with naming_parts(config, "at the end", slam.check_estimate):
                trace.wall_time_s = time.perf_counter() - began
                finish(trace, slam, pilot, "interrupted" if outcome == "log ended" and interrupted() else outcome)
    return trace


def _slam(start: Pose, trace: Trace, pilot: Pilot, prior: PriorStart | None) -> Slam:
    """SLAM from `start`, or from a prior map and the start in it; who plans nothing needs no map before the end."""
    fields: dict[str, Any] = {"radius_m": trace.radius_m, "clock": trace.stopwatch.stage}
    fields["draws_map"] = pilot.navigator.plans_below_margin is not None
    if prior is None:
        return Slam(trace.config, start, **fields)
    trace.prior_map = prior.note()
    return Slam(trace.config, prior.pose or start, start_cov=prior.cov, prior_map=prior.map, **fields)
