"""Records of runs with general values: no two numbers are equal, and no pose, shape or covariance is special."""

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.logs.log import Relations
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.record.folder import RunFolder
from sixthsense.record.trace import STAGES, Trace
from sixthsense.simulation.scene import Scene
from sixthsense.simulation.scene_files import ScriptedWalk
from sixthsense.slam.association.records import Association, Record
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.front_end import LoopClosureCounts, PoseLinks
from sixthsense.slam.mapping.grid import Grid
from sixthsense.verdict.verdict import Cause, Verdict

CONFIG = preset(grid={"cell_m": 0.07}, laser={"mount": [0.21, -0.13, 0.4], "max_range": 7.3})
RADIUS_M = 0.23


def cov_of(rng: np.random.Generator, size: int = 3) -> Array:
    half = rng.normal(size=(size, size))
    return half @ half.T + 0.1 * np.eye(size)


def pose_of(rng: np.random.Generator) -> Pose:
    return Pose(*rng.normal(0.0, 9.0, 2), rng.uniform(-math.pi, math.pi))


def poses_of(rng: np.random.Generator, count: int) -> list[Array]:
    return [pose_of(rng).array() for _ in range(count)]


def observation_of(rng: np.random.Generator, kind: Kind) -> Observation:
    return Observation(kind, rng.normal(0.0, 4.0, 2), cov_of(rng, 2), tuple(rng.normal(size=2).tolist()))


def scene_of(rng: np.random.Generator) -> Scene:
    walk = ScriptedWalk(points=((1.5, 2.5), (-3.5, 4.5)), speed=0.7, pauses=(2.0, 3.0))
    goal, *tour = map(tuple, rng.normal(size=(4, 2)).tolist())
    region = tuple(rng.normal(size=4).tolist())
    segments = rng.normal(size=(5, 2, 2))
    return Scene("hall", segments[:3], pose_of(rng), 0.31, goal, tuple(tour), region, True, segments[3:], (walk,))


def trace_of(rng: np.random.Generator, scans: int = 7, keys: int = 4) -> Trace:
    """A trace in which no two numbers are equal."""
    trace = Trace(CONFIG, scene_of(rng), RADIUS_M)
    trace.stamps_ns = np.cumsum(rng.integers(1, 10**12, scans)).tolist()
    trace.key_stamps_ns = trace.stamps_ns[:keys]
    trace.log_stamps_s = [math.nan, *rng.uniform(0.0, 1e9, scans - 1).tolist()]
    trace.estimates, trace.odometry, trace.truths, trace.since_key = (poses_of(rng, scans) for _ in range(4))
    trace.walkers = [rng.normal(size=(2, 3)) for _ in range(scans)]
    trace.touches = (3, 5)
    trace.since_covs = [cov_of(rng) for _ in range(scans)]
    trace.last_key = [-1, *rng.integers(0, keys, scans - 1).tolist()]
    trace.key_odometry = [Odometry(pose_of(rng), cov_of(rng)) for _ in range(keys)]
    trace.key_predicted, trace.key_estimates = (
        [Estimate.of_pose(pose_of(rng), cov_of(rng)) for _ in range(keys)] for _ in range(2)
    )
    trace.key_truths = poses_of(rng, keys)
    kinds = {4: Kind.CORNER, 7: Kind.WALL, 11: Kind.END, 12: Kind.WALL, 13: Kind.CORNER}
    for k in range(keys):
        seen = {i: observation_of(rng, kind) for i, kind in kinds.items() if i % keys != k and i != 13}
        trace.associations.append(Association(seen, 2 + k, 7.5 + k, 20 + k, 40 + k))
    trace.walls_found = [rng.normal(size=(k, 2, 2)) for k in range(keys)]
    trace.stopwatch.rows = [dict(zip(STAGES, rng.random(len(STAGES)).tolist(), strict=True)) for _ in range(keys)]
    trace.stopwatch.totals = dict(zip(STAGES, rng.random(len(STAGES)).tolist(), strict=True))
    trace.outcome, trace.path_length_m, trace.wall_time_s = "explored in part", 17.25, 3.5
    trace.plans = [rng.normal(size=(k, 2)) for k in (3, 1, 2)]
    trace.plans_below_margin, trace.plans_by_astar, trace.guard_stops = 6, 8, 9
    trace.culled, trace.walls_merged = 13, 14
    trace.left = [UnseenPlace(1.5, -2.5, 0.75, "gave up"), UnseenPlace(-3.5, 4.5, 0.25, "unreachable", 0.35)]
    trace.trajectory = np.array(poses_of(rng, keys))
    # 12 was seen and removed; 13 is of an earlier run and was not seen again.
    ids, walls = np.array([7, 4, 13, 11], dtype=np.int64), np.array([True, False, False, False])
    trace.joint_cov = cov_of(rng, 11)
    trace.final = Estimate(pose_of(rng), trace.joint_cov[:3, :3], ids, rng.normal(size=(4, 2)), walls)
    for k, (i, kind) in enumerate(kinds.items()):
        trace.records[i] = Record(kind, 3 + k, 30 + k, 50 + k, rng.normal(size=(2, 2)))
    trace.loop_closures = LoopClosureCounts(21, 22, 23)
    trace.links = PoseLinks(np.array([[0, 2], [3, 1]]), np.array(poses_of(rng, 2)), np.array([cov_of(rng)] * 2))
    trace.wheels, trace.sensor = rng.normal(size=(2, 3)), rng.normal(size=(2, 2))
    trace.relations = Relations(rng.uniform(0.0, 1e9, (2, 2)), np.array(poses_of(rng, 2)))
    trace.last_position = rng.normal(size=2)
    cause = Cause("slip", "the wheels slipped", 1.5, 2.5, rng.normal(size=(2, 2)))
    trace.verdict = Verdict("doubtful", 0.375, rng.random(keys), (cause,), {"agreement": 0.625})
    trace.key_measured = [k % 2 == 0 for k in range(keys)]
    trace.tours = [rng.normal(size=(k, 2)) for k in (4, 2)]
    hits, passes, seen = rng.integers(0, 9, (5, 8)), rng.integers(0, 9, (5, 8)), rng.random((5, 8)) < 0.7
    for counts in (hits, passes, seen):  # the map is cropped to what is known
        counts[:1], counts[:, :2], counts[:, -1:] = 0, 0, 0
    corner = (CONFIG.grid.cell_m * -3, CONFIG.grid.cell_m * 4)
    trace.grid = Grid.from_counts(CONFIG.grid, RADIUS_M, corner, hits.astype(np.int32), passes.astype(np.int32), seen)
    return trace


@contextmanager
def written(trace: Trace) -> Iterator[Path]:
    """The folder of a run with this record."""
    with tempfile.TemporaryDirectory() as place:
        folder = RunFolder(Path(place) / "run", CONFIG)
        folder.write(trace, {"some": 1.5})
        folder.finish()
        yield folder.out
