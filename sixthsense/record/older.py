"""The trace of a run's folder that has no `record.jsonl`: as much of it as its bag says."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sixthsense.config import Config
from sixthsense.config.platform import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Pose
from sixthsense.core.motion import Odometry, odometry
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.keyframes import Keyframes
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.slam import Keyframe, Step
from sixthsense.sources.logs.runfolder import read_run
from sixthsense.sources.replay_input import recorded_scene


def trace_of_bag(folder: Path, config: Config) -> Trace:
    """Poses, truth and plans of a run, from its bag: without landmarks, walls, innovations and times.

    Raises LogError for a folder without a bag, and a bag without a scan.
    """
    log = read_run(folder, config.laser)
    scene = recorded_scene(log, config)
    trace = Trace(config, scene, config.robot.radius or (DEFAULT_ROBOT_RADIUS_M if scene is None else scene.radius))
    trace.plans = [path for _, path in log.plans]
    estimates = {stamp_ns: (pose, cov) for stamp_ns, pose, cov in log.estimates}
    pose, before, folded = log.start, log.ticks[0].odometry, Keyframes(config.keyframes)
    no_grid = Grid(config.grid, trace.radius_m)
    for k, tick in enumerate(log.ticks):
        if k:
            increment = odometry(before, tick.odometry, config.assumed)
            if tick.increment_cov is not None:
                increment = Odometry(before.inverse() @ tick.odometry, tick.increment_cov)
            pose = pose @ increment.motion
            folded.moved(increment)
            before = tick.odometry
        if tick.stamp_ns in estimates:
            pose, cov = estimates[tick.stamp_ns]
            unknown = Estimate.of_pose(Pose(), np.zeros((3, 3)))
            trace.add_keyframe(tick, Keyframe(folded.take(), unknown, Estimate.of_pose(pose, cov)))
        trace.add_tick(tick, tick.odometry)
        if tick.scan is not None or tick.observations is not None:
            since = folded.since.motion, folded.since.cov
            trace.add_scan(tick, Step(tick.stamp_ns, pose, tick.odometry, None, *since, None, None, no_grid))
    return trace
