"""The loop, from sensor data to command: a simulated world and a log drive the same `Slam`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sixthsense.config import Config
from sixthsense.config.platform import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Pose
from sixthsense.core.interrupt import deferred_interrupt
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Command, Source, Tick
from sixthsense.navigation import make_navigator
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator, ReplayNavigator
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.recorder import Recorder
from sixthsense.record.stopwatch import Stopwatch
from sixthsense.record.trace import Trace
from sixthsense.slam.prior_map import PriorStart
from sixthsense.slam.slam import Slam, Step
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.relations import Relations
from sixthsense.sources.mission import mission
from sixthsense.sources.replay_input import recorded_scene
from sixthsense.sources.scene import Scene, load_scene
from sixthsense.sources.world import World

OnTick = Callable[[Tick, Trace], None]
"""Hook of a caller: called after every tick with it and the record so far."""

Watcher = Callable[[Tick, Step, Command], str | None]
"""Called after every tick; an outcome that it returns ends the run."""


def drive(source: Source, slam: Slam, pilot: Pilot, watchers: Sequence[Watcher], clock: Stopwatch) -> str:
    """Run until the task is over, a watcher ends it, or the source has no more ticks; returns the outcome."""
    sense, steer = clock.timed("sense", source.step), clock.timed("plan", pilot.steer)
    command = Command()
    while (tick := sense(command)) is not None:
        step = slam.take(tick)
        command = steer(step)
        outcome: str | None = "collided" if tick.collided else pilot.navigator.outcome
        for watch in watchers:
            ended = watch(tick, step, command)
            outcome = outcome or ended
        if outcome is not None:
            return outcome
    return "log ended"


def run(
    config: Config, on_tick: OnTick | None = None, scene: Scene | None = None, prior: PriorStart | None = None
) -> Trace:
    """Simulate `config.scene` and drive its task.

    `scene` is that scene where it is loaded already; `on_tick` is called after every tick with it and the trace so far.
    With `prior` the robot begins with the map of an earlier run; the true start is that of scene and configuration.
    Ctrl-C ends the run in order, as "interrupted". Raises SceneError for an invalid scene, start or goal, ConfigError
    and PriorMapError for a prior map that cannot be used.
    """
    scene = scene or load_scene(config.scene, config.map_unknown)
    start, goals, radius_m = mission(scene, config)
    streams = random_streams(config.seed)
    source = World(scene.walls, start, radius_m, config, streams.world, scene.glass)
    region = config.region or scene.region
    believed = start if prior is None or prior.pose is None else prior.pose
    navigator = make_navigator(config, believed, goals, region, radius_m, streams.planner, streams.exploration)
    return recorded_drive(source, start, navigator, Trace(config, scene, radius_m, name=scene.name), on_tick, prior)


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
    log.rewind()
    scene = recorded_scene(log, config)
    radius_m = config.robot.radius or (DEFAULT_ROBOT_RADIUS_M if scene is None else scene.radius)
    trace = Trace(config, scene, radius_m, relations=relations, name="log" if scene is None else scene.name)
    return recorded_drive(log, log.start, ReplayNavigator(), trace, on_tick, prior)


def recorded_drive(
    source: Source,
    start: Pose,
    navigator: Navigator,
    trace: Trace,
    on_tick: OnTick | None = None,
    prior: PriorStart | None = None,
) -> Trace:
    """Run the loop with recorder, hook, deadline and interrupt as watchers, and return the record."""
    config, clock = trace.config, trace.stopwatch
    pilot = Pilot(navigator, Guard(config, trace.radius_m))
    with _slam(start, trace, clock, prior) as slam:
        recorder = Recorder(trace, slam, pilot)
        with deferred_interrupt() as interrupted:
            watchers: list[Watcher] = [recorder]
            if on_tick is not None:
                watchers.append(lambda tick, step, command: on_tick(tick, trace))
            if config.max_time is not None:
                watchers.append(_Deadline(config.max_time, navigator.timeout_outcome))
            watchers.append(lambda tick, step, command: "interrupted" if interrupted() else None)
            recorder.finish(drive(source, slam, pilot, watchers, clock))
    return trace


def _slam(start: Pose, trace: Trace, clock: Stopwatch, prior: PriorStart | None) -> Slam:
    """SLAM from `start`, or from a prior map and the start in it."""
    if prior is None:
        return Slam(trace.config, start, radius_m=trace.radius_m, timed=clock.timed)
    trace.prior_map = prior.note()
    return Slam(
        trace.config,
        prior.pose or start,
        start_cov=prior.cov,
        radius_m=trace.radius_m,
        timed=clock.timed,
        prior_map=prior.map,
    )


class _Deadline:
    """Ends a run when `max_time_s` of source time has passed."""

    def __init__(self, max_time_s: float, outcome: str) -> None:
        self._max_ns, self._outcome = round(max_time_s * 1e9), outcome
        self._first_ns: int | None = None

    def __call__(self, tick: Tick, step: Step, command: Command) -> str | None:
        if self._first_ns is None:
            self._first_ns = tick.stamp_ns
        return self._outcome if tick.stamp_ns >= self._first_ns + self._max_ns else None
