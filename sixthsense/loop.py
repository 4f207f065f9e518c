"""The loop, from evidence to command, for a simulated world and for a log alike (CONTRIBUTING.md draws it)."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from sixthsense.config import AssumedConfig, Config, KeyScanConfig, merge
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.interrupt import deferred_interrupt
from sixthsense.core.motion import STANDSTILL, Odometry, odometry
from sixthsense.core.source import Command, Source, Tick
from sixthsense.evaluation.measure import measure
from sixthsense.navigation.explore import Explorer
from sixthsense.navigation.follow import Follower
from sixthsense.navigation.navigate import Driver, Navigator, Passenger
from sixthsense.navigation.planners import make_planner
from sixthsense.navigation.safety import Guard
from sixthsense.record.live import Live
from sixthsense.record.trace import Trace
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import make_estimator
from sixthsense.slam.features import extract
from sixthsense.slam.features.deskew import Deskewer
from sixthsense.slam.mapping.mapper import Mapper
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.relations import Relations
from sixthsense.sources.scene import Scene, SceneError, check_placement, load_scene
from sixthsense.sources.world import World

OnTick = Callable[[Tick, Trace], None]

NO_WALLS = np.zeros((0, 2, 2))

LOG_RADIUS_M = 0.2  # of a recorded robot whose configuration names none


def run(config: Config, on_tick: OnTick | None = None) -> Trace:
    """Simulate `config.scene` and drive its task.

    Raises SceneError for a scene, start or goal that will not do. `on_tick` is called after every tick with
    it and the trace so far; Ctrl-C ends the run in order, as "interrupted".
    """
    scene = load_scene(config.scene)
    start, goals, radius_m = mission(scene, config)
    world_rng, ransac_rng, planner_rng, explore_rng = _streams(config.seed)
    source = World(scene.walls, start, radius_m, config, world_rng)
    follower = Follower(config.follow, config.robot)
    planner = make_planner(config.planner, config.rrtstar, planner_rng)
    navigator: Navigator
    if config.task == "explore":
        region = config.region or scene.region
        navigator = Explorer(start, region, radius_m, planner, follower, config, explore_rng)
    else:
        navigator = Driver(goals, config.task == "tour", planner, follower, config)
    trace = Trace(config, scene, radius_m, name=scene.name)
    drive(source, start, navigator, trace, ransac_rng, on_tick)
    return trace


def replay(log: Log, config: Config, relations: Relations | None = None, on_tick: OnTick | None = None) -> Trace:
    """Digest a recorded log with the same middle of the loop; the robot goes where it went.

    With `relations` the metrics compare the trajectory with them. A recorded run has its truth in the log, and its
    scene, if that still loads, in `config`.
    """
    log.rewind()
    scene = _recorded_scene(log, config)
    radius_m = config.robot.radius or (LOG_RADIUS_M if scene is None else scene.radius)
    _, ransac_rng, *_ = _streams(config.seed)
    trace = Trace(config, scene, radius_m, relations=relations, name="log" if scene is None else scene.name)
    drive(log, log.start, Passenger(), trace, ransac_rng, on_tick)
    return trace


def _streams(seed: int) -> list[np.random.Generator]:
    """Randomness of the world, of RANSAC, of the planner and of exploration, apart.

    So a replay repeats the second alone, and a change of planner leaves the noise alone.
    """
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]


def _recorded_scene(log: Log, config: Config) -> Scene | None:
    if log.ticks[0].truth is None or not log.scans:
        return None
    try:
        return load_scene(config.scene)
    except SceneError:
        return None  # the record outlives the file


def mission(scene: Scene, config: Config) -> tuple[Pose, Array, float]:
    """Start, goals (N, 2) and robot radius of a task, from the configuration or else from the scene.

    An exploration has no goals.

    Raises SceneError, naming the field, for a place that is missing, outside the region or too near a wall.
    """
    start = Pose(*config.start) if config.start is not None else scene.start
    goal = config.goal if config.goal is not None else scene.goal
    if config.task == "goal" and goal is None:
        raise SceneError(f"goal: missing, the scene {scene.name} has none of its own, allowed: x y")
    if config.task == "tour" and not scene.tour:
        raise SceneError(
            f"task: found 'tour', but the scene {scene.name} lists no goals for one, allowed: explore, goal"
        )
    if config.task == "explore" and config.goal is not None:
        raise SceneError(
            f"goal: found ({config.goal[0]:g}, {config.goal[1]:g}) with task explore, allowed: with task goal"
        )
    if config.task != "goal":
        goal = None
    tour = scene.tour if config.task == "tour" else ()
    check_placement(scene, start, goal, config.region, config.robot.radius, tour)
    assert start is not None  # check_placement has seen to it
    goals = np.array(tour if goal is None else (goal,), dtype=np.float64).reshape(-1, 2)
    return start, goals, config.robot.radius or scene.radius


def warm_up() -> None:
    """Compile the hot loops, or load them compiled, so that the first key scan is as quick as the rest."""
    walls = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[1, 0], [1, 1]], [[-2, 2], [-2, -2]]], dtype=np.float64)
    config = Config(max_time=3.0)
    scene = Scene("room", walls, Pose(), 0.2, (1.0, 1.0), (), (-2.0, -2.0, 2.0, 2.0))
    rng = np.random.default_rng(0)
    follower = Follower(config.follow, config.robot)
    planner = make_planner("astar")
    driver = Explorer(Pose(), (-3.0, -3.0, 3.0, 3.0), 0.2, planner, follower, config, rng)
    trace = Trace(config, scene, 0.2)
    drive(World(walls, Pose(), 0.2, config, rng), Pose(), driver, trace, rng)
    measure(trace)
    assert trace.grid is not None
    space = trace.grid.free_space()
    for _ in range(2):  # the second is a replan
        planner.plan(space, (0.0, 0.0), (1.0, 1.0))
    # What most runs do without: scans that take time, and a search that is bounded.
    swept = merge(config, {"laser": {"sweep_s": 0.1}})
    deskew, tick = Deskewer(), World(walls, Pose(), 0.2, swept, rng).step(Command())
    deskew.moved(0, STANDSTILL)
    assert tick is not None and tick.scan is not None
    extract(deskew(tick.scan), config.assumed, config.features, rng)
    mapper = Mapper(config.grid, 0.2)
    mapper.add(np.zeros((1, 3)), tick.scan, NO_WALLS)
    mapper.grid.free_space(margin_m=0.1).between((0.0, 0.0), (1.0, 0.0), 1.0)
    # What the imports left behind is there to stay: a collection that walks it takes as long as sixty key scans.
    gc.collect()
    gc.freeze()


class KeyScans:
    """Decides which scans are used: those after enough motion since the last one used; folds the motion between."""

    def __init__(self, config: KeyScanConfig) -> None:
        self._config = config
        self._first = True
        self.since = STANDSTILL
        """motion since the last key scan"""

    def moved(self, increment: Odometry) -> None:
        """Take an increment of motion in."""
        self.since = self.since.then(increment) if self.since is not STANDSTILL else increment

    def due(self, tick: Tick) -> bool:
        """Whether what the tick brings is used: a scan after enough motion, or sightings of landmarks known by name."""
        if tick.scan is None:
            return bool(tick.sightings)
        motion = self.since.motion
        distance, turn = math.hypot(motion.x, motion.y), abs(motion.theta)
        far = distance >= self._config.distance_m or turn >= self._config.turn_rad
        return self._first or (far and (distance > 0.0 or turn > 0.0))

    def take(self) -> Odometry:
        """The motion since the last key scan; counting starts anew."""
        motion, self.since, self._first = self.since, STANDSTILL, False
        return motion


def drive(
    source: Source,
    start: Pose,
    navigator: Navigator,
    trace: Trace,
    rng: np.random.Generator,
    on_tick: OnTick | None = None,
) -> None:
    """Run until the task is over, the source ends or `max_time` is reached; `start` is where the estimator begins."""
    config, watch = trace.config, trace.stopwatch
    estimator = make_estimator(config.estimator, start, np.zeros((3, 3)), config.isam2)
    associator = Associator(config.association)
    mapper = Mapper(config.grid, trace.radius_m)
    keyscans = KeyScans(config.keyscans)
    guard, deskew = Guard(config, trace.radius_m), Deskewer(config.features.deskew)
    command, pose = Command(), start
    trace.plans, trace.grid = navigator.plans, mapper.grid
    trace.live = live = Live(estimator, associator.records)
    before: Pose | None = None
    deadline_ns, T_world_odom = 0, Pose()
    began = time.perf_counter()
    # One BLAS thread: with more, results differ from run to run, and small matrices are slower.
    with threadpool_limits(limits=1, user_api="blas"), deferred_interrupt() as interrupted:
        while True:
            watch.start()
            tick = source.step(command)
            watch.lap("sense")
            if tick is None:
                trace.outcome = "log ended"
                break
            if before is None:
                deadline_ns = tick.stamp_ns + round(config.max_time * 1e9)
                T_world_odom = start @ tick.odometry.inverse()
                deskew.moved(tick.stamp_ns, STANDSTILL)
            else:
                increment = _increment(before, tick, config.assumed)
                keyscans.moved(increment)
                guard.moved(increment.motion)
                deskew.moved(tick.stamp_ns, increment)
                pose = pose @ increment.motion
            before = tick.odometry
            scan = None
            if tick.scan is not None:
                live.scan = scan = deskew(tick.scan)
                guard.see(scan)
            watch.lap("predict")
            if keyscans.due(tick):
                motion = keyscans.take()
                estimator.predict(motion)
                watch.lap("predict")
                if scan is not None:
                    live.features = features = extract(scan, config.assumed, config.features, rng)
                    walls = features.walls
                    watch.lap("extract")
                    association = associator.associate(features.sightings, estimator)
                else:
                    walls = NO_WALLS
                    association = associator.known(tick.sightings or {}, estimator)
                watch.lap("associate")
                estimator.update(association.sightings)
                estimator.forget([*associator.cull(), *associator.merged(estimator)])
                estimate = estimator.estimate()
                pose = estimate.pose
                watch.lap("update")
                if scan is not None:
                    mapper.add(estimator.trajectory(), scan, walls)
                watch.lap("grid")
                navigator.look(mapper.grid, estimate)
                watch.lap("plan")
                watch.key_scan()
                trace.add_key_scan(tick, motion, estimate, association, walls)
            command = guard.check(navigator.step(pose, tick.stamp_ns))
            if guard.blocked:
                navigator.blocked(pose)
            watch.lap("plan")
            dead_reckoned = T_world_odom @ tick.odometry
            trace.add_tick(tick, dead_reckoned)
            if tick.scan is not None or tick.sightings is not None:
                trace.add_scan(tick, pose, dead_reckoned, keyscans.since.motion)
            if on_tick is not None:
                on_tick(tick, trace)
            outcome: str | None = "collided" if tick.collided else navigator.outcome
            if outcome is None and tick.stamp_ns >= deadline_ns:
                outcome = navigator.at_the_end
            if outcome is None and interrupted():
                outcome = "interrupted"
            if outcome is not None:
                trace.outcome = outcome
                break
    trace.wall_time_s = time.perf_counter() - began
    trace.live = None
    if navigator.plans_below_margin is not None:
        trace.guard_stops, trace.plans_below_margin = guard.stops, navigator.plans_below_margin
        trace.plans_by_astar = navigator.plans_by_astar
    trace.left = navigator.left
    estimator.predict(keyscans.take())
    trace.final = estimator.estimate()
    trace.joint_cov = estimator.joint_covariance(trace.final.ids.tolist())
    trace.trajectory = estimator.trajectory()
    trace.records, trace.culled, trace.walls_merged = associator.records, associator.culled, associator.walls_merged
    trace.rebuilds = mapper.rebuilds


def _increment(before: Pose, tick: Tick, assumed: AssumedConfig) -> Odometry:
    """The motion since the last tick, with the covariance that the log states, or else that of the assumed noise."""
    if tick.increment_cov is None:
        return odometry(before, tick.odometry, assumed)
    return Odometry(before.inverse() @ tick.odometry, tick.increment_cov)
