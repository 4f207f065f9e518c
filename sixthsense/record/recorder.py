"""Fills the record of a run: a watcher of the loop."""

from __future__ import annotations

import time

from sixthsense.core.geometry import Array
from sixthsense.core.source import Command, ControlTicks, Tick
from sixthsense.navigation.pilot import Steersman
from sixthsense.record.trace import Live, Trace
from sixthsense.slam.slam import Slam, Step


class Recorder:
    """Appends what each tick brought to a trace."""

    def __init__(self, trace: Trace, slam: Slam, pilot: Steersman) -> None:
        """Record into `trace`, which shows the plans and the map from now on."""
        self._trace, self._slam, self._pilot = trace, slam, pilot
        trace.plans, trace.tours, trace.grid = pilot.navigator.plans, pilot.navigator.tours, slam.grid
        trace.live = Live(slam.estimator, slam.associator.records, slam.associator)
        self._began = time.perf_counter()

    def __call__(self, tick: Tick, step: Step, command: Command) -> None:
        """Record one tick."""
        trace, keyframe = self._trace, step.keyframe
        trace.stopwatch.end_tick(keyframe is not None)
        assert trace.live is not None
        trace.live.scan, trace.live.since_cov = step.scan or trace.live.scan, step.since_cov
        if keyframe is not None:
            trace.live.features = keyframe.features
            trace.add_keyframe(tick, keyframe)
        trace.add_tick(tick, step.dead_reckoned, step.increment is not None and step.increment.is_carried())
        if tick.scan is not None or tick.observations is not None:
            trace.add_scan(tick, step)

    def passed(self, ticks: ControlTicks, since_cov: Array) -> None:
        """Record ticks between two scans; `since_cov` (3, 3) is of the motion since the last keyframe after them."""
        trace = self._trace
        trace.stopwatch.end_tick(False)
        assert trace.live is not None
        trace.live.since_cov = since_cov
        trace.add_ticks(ticks)

    def finish(self, outcome: str) -> None:
        """Record how the run ended, and what is known then."""
        trace, navigator = self._trace, self._pilot.navigator
        trace.outcome = outcome
        trace.wall_time_s = time.perf_counter() - self._began
        trace.live = None
        trace.left = navigator.left
        if navigator.plans_below_margin is not None:
            trace.guard_stops, trace.plans_below_margin = self._pilot.guard.stops, navigator.plans_below_margin
            trace.plans_by_astar = navigator.plans_by_astar
        result = self._slam.finish()
        trace.final, trace.joint_cov, trace.trajectory = result.estimate, result.joint_cov, result.trajectory
        trace.records = dict(result.landmark_records)
        trace.culled, trace.walls_merged, trace.rebuilds = result.culled, result.walls_merged, result.rebuilds
        trace.loop_closures, trace.links = result.loop_closures, result.links
        if result.wheels is not None:
            trace.wheels = result.wheels.with_sigmas()
        if result.sensor is not None:
            trace.sensor = result.sensor.with_sigmas()
        if result.since_key is not None:
            trace.since_key = list(result.since_key)
