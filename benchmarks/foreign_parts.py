"""Parts that are written on other libraries, through the same tours and logs as the package's own.

    python benchmarks/foreign_parts.py --seeds 3                              # tours alone, about 5 minutes
    SIXTHSENSE_DATA=FOLDER python benchmarks/foreign_parts.py --tours --logs fr079 intel    # logs alone, 3 minutes

`Gicp` is a front end that aligns scans with small_gicp (pip install small_gicp), each keyframe with the one before.
`LeastSquares` is an estimator on sparse matrices of scipy. The other row of each is the package's own part in its
place: scan matching, of which the loop closures are switched off to compare like with like, and `isam2`. A tour's row
has ATE and NEES over the seeds, a log's the errors of the relations.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import arguments, check_at_least, finish
from scipy import sparse
from scipy.sparse.linalg import splu

import sixthsense as ss
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Observation, initialize_landmark, innovations, predict
from sixthsense.core.motion import STANDSTILL, Odometry, compose_jacobians
from sixthsense.slam.estimators import Estimate, Link
from sixthsense.slam.front_end import Evidence, Finished, FrontEndSetup, Keyframe, is_due

TOURS, TOUR_S = ("apartment", "office"), 120.0
LOGS = ("fr079", "intel")
_LAYERS = 5
"""in which a scan is stood up: a plane in three dimensions for each wall"""
_FLOOR = 1e-11 * np.eye(3)
"""added to covariances of motions, which may be zero; m^2 and rad^2"""
_ITERATIONS, _SMALL = 5, 1e-8


class Gicp:
    """Scan matching by small_gicp: each keyframe is linked to the one before by point-to-plane ICP."""

    def __init__(self, setup: FrontEndSetup) -> None:
        self._estimator, self._limits = setup.estimator, setup.config.keyframes
        self._sigma_m = setup.config.assumed.laser.range_m
        self.pose, self.since, self._count = setup.start, STANDSTILL, 0
        self._before: Array | None = None

    def take(self, evidence: Evidence) -> Keyframe | None:
        """Predict by odometry; at a keyframe, link it to the one before."""
        if evidence.increment is not None:
            self.since = self.since.then(evidence.increment)
            self.pose = self.pose @ evidence.increment.motion
        if evidence.still is None or not (self._count == 0 or is_due(self.since.motion, self.since, self._limits)):
            return None
        motion, self.since, points = self.since, STANDSTILL, _stood_up(evidence.still)
        self._estimator.predict(motion)
        predicted = self._estimator.estimate()
        self._estimator.update({})
        if self._before is not None and (found := self._aligned(self._before, points, motion.motion)) is not None:
            self._estimator.link([Link(self._count - 1, self._count, found)])
        estimate = self._estimator.estimate()
        self._before, self.pose, self._count = points, estimate.pose, self._count + 1
        return Keyframe(self._count - 1, motion, predicted, estimate)

    def finish(self) -> Finished:
        """Predict to the last tick."""
        self._estimator.predict(self.since)
        self.since = STANDSTILL
        return Finished(self._estimator.estimate())

    def _aligned(self, before: Array, after: Array, guess: Pose) -> Odometry | None:
        """The motion between two scans with its covariance, 2 sigma^2 / H; None where they do not fit."""
        import small_gicp

        initial = np.eye(4)
        initial[:2, :2], initial[:2, 3] = rotation(guess.theta), guess.position
        found = small_gicp.align(
            before, after, initial, "PLANE_ICP", downsampling_resolution=0.05, max_correspondence_distance=0.3,
            num_threads=1, max_iterations=30,
        )  # fmt: skip
        H = np.asarray(found.H)[np.ix_([3, 4, 2], [3, 4, 2])] / _LAYERS  # of x, y and the heading, in the later frame
        if not found.converged or np.linalg.eigvalsh(H)[0] < 1.0:
            return None
        T = np.asarray(found.T_target_source)
        motion = Pose(float(T[0, 3]), float(T[1, 3]), float(np.arctan2(T[1, 0], T[0, 0])))
        cov = np.linalg.inv(H) * 2.0 * self._sigma_m**2
        return Odometry(motion, 0.5 * (cov + cov.T))


def _stood_up(scan: Any) -> Array:
    """(N, 3) points of a scan in the robot's frame, one above the other, so that walls have normals."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    bearings = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    seen = np.isfinite(ranges)
    flat = scan.T_robot_laser @ (ranges[seen, None] * np.column_stack([np.cos(bearings[seen]), np.sin(bearings[seen])]))
    heights = np.repeat(0.1 * np.arange(_LAYERS), len(flat))
    return np.column_stack([np.tile(flat, (_LAYERS, 1)), heights])


class LeastSquares:
    """All poses and landmarks by Gauss-Newton on sparse matrices: every factor is linearized anew at each update.

    Contract 8 of `Estimator` holds with walls. A landmark that is forgotten stays in the graph, so that the others keep
    what it told.
    """

    def __init__(self, start: Pose, start_cov: Array) -> None:
        self._start, self._prior = start.array(), np.linalg.inv(np.asarray(start_cov) + _FLOOR)
        self._poses, self._motions = start.array()[None], list[Odometry]()
        self._since = STANDSTILL
        self._updated_at: list[int] = []
        """rows of the poses"""
        self._means, self._walls = np.zeros((0, 2)), np.zeros(0, dtype=np.bool_)
        self._rows: dict[LandmarkId, int] = {}
        """of each known landmark"""
        self._seen: list[tuple[list[int], list[Observation]]] = [([], [])]
        """landmarks that are observed from each pose, with the observations"""
        self._solve()

    def predict(self, odometry: Odometry) -> None:
        """Add to the motion since the last update."""
        self._since = self._since.then(odometry)

    def update(self, observations: Mapping[LandmarkId, Observation]) -> None:
        """Add a pose with its observations, and solve."""
        pose = self._now()
        if self._since.cov.any() or self._since.motion != Pose():  # else it is the same pose as before
            self._motions.append(self._since)
            self._poses, self._since = np.vstack([self._poses, pose.array()]), STANDSTILL
            self._seen.append(([], []))
        self._updated_at.append(len(self._poses) - 1)
        for i, observation in observations.items():
            if i not in self._rows:
                self._rows[i] = len(self._means)
                self._means = np.vstack([self._means, initialize_landmark(pose, observation)[0]])
                self._walls = np.append(self._walls, observation.is_wall)
        rows, seen = self._seen[-1]
        rows += [self._rows[i] for i in observations]
        seen += observations.values()
        self._solve()

    def forget(self, ids: Collection[LandmarkId]) -> None:
        """Forget landmarks, not what they told."""
        rows = {i: self._rows[i] for i in ids}  # KeyError for an unknown one, before anything has changed
        self._rows = {i: row for i, row in self._rows.items() if i not in rows}

    def estimate(self) -> Estimate:
        """The pose now, and the landmarks."""
        rows = list(self._rows.values())
        ids = np.array(list(self._rows), dtype=np.int64)
        return Estimate(self._now(), self._covariance([]), ids, self._means[rows], self._walls[rows])

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose now and k landmarks."""
        return self._covariance([self._rows[i] for i in ids])

    def trajectory(self) -> Array:
        """(K, 3) of all updates."""
        return self._poses[self._updated_at]

    def _now(self) -> Pose:
        return Pose.from_array(self._poses[-1]) @ self._since.motion

    def _covariance(self, rows: Sequence[int]) -> Array:
        count = len(self._poses)
        columns = [*range(3 * count - 3, 3 * count), *(3 * count + 2 * r + n for r in rows for n in (0, 1))]
        size = 3 * count + 2 * len(self._means)
        units = sparse.csc_matrix((np.ones(len(columns)), (columns, range(len(columns)))), shape=(size, len(columns)))
        joint = np.asarray(self._factor.solve(units.toarray()))[columns]
        phi, g = compose_jacobians(float(self._poses[-1, 2]), self._since.motion)
        F = np.eye(len(columns))
        F[:3, :3] = phi
        joint = F @ joint @ F.T
        joint[:3, :3] += g @ self._since.cov @ g.T
        return np.asarray(0.5 * (joint + joint.T))

    def _solve(self) -> None:
        for _ in range(_ITERATIONS):
            information, gradient = self._linearized()
            self._factor = splu(information)
            step = self._factor.solve(gradient)
            count = len(self._poses)
            self._poses = self._poses + step[: 3 * count].reshape(-1, 3)
            self._means = self._means + step[3 * count :].reshape(-1, 2)
            if np.abs(step).max() < _SMALL:
                break
        self._factor = splu(self._linearized()[0])

    def _linearized(self) -> tuple[Any, Array]:
        """Information matrix and gradient of all factors at the present estimate."""
        count = len(self._poses)
        size = 3 * count + 2 * len(self._means)
        blocks, gradient = list[tuple[Array, Array]](), np.zeros(size)

        def add(index: Array, jacobian: Array, error: Array, information: Array) -> None:
            blocks.append((index, jacobian.T @ information @ jacobian))
            gradient[index] -= jacobian.T @ information @ error

        off = self._poses[0] - self._start
        off[2] = wrap_angle(off[2])
        add(np.arange(3), np.eye(3), off, self._prior)
        for k, motion in enumerate(self._motions):
            jacobian, error = _between(self._poses[k], self._poses[k + 1], motion.motion.array())
            add(np.arange(3 * k, 3 * k + 6), jacobian, error, np.linalg.inv(motion.cov + _FLOOR))
        for k, (rows, observations) in enumerate(self._seen):
            if rows:
                walls = self._walls[rows]
                expected, by_pose, by_landmark = predict(Pose.from_array(self._poses[k]), self._means[rows], walls)
                errors = -innovations(np.array([o.z for o in observations]), expected, walls)
                for j, row in enumerate(rows):
                    index = np.array([*range(3 * k, 3 * k + 3), 3 * count + 2 * row, 3 * count + 2 * row + 1])
                    jacobian = np.hstack([by_pose[j], by_landmark[j]])
                    add(index, jacobian, errors[j], np.linalg.inv(observations[j].cov))
        at = [np.meshgrid(index, index, indexing="ij") for index, _ in blocks]
        rows_, cols = (np.concatenate([pair[n].ravel() for pair in at]) for n in (0, 1))
        values = np.concatenate([block.ravel() for _, block in blocks])
        return sparse.csc_matrix((values, (rows_, cols)), shape=(size, size)), gradient


def _between(a: Array, b: Array, motion: Array) -> tuple[Array, Array]:
    """Jacobian (3, 6) and error (3,) of a measured motion between two poses (3,), axes of its end."""
    c, s = np.cos(a[2]), np.sin(a[2])
    back, step = np.array([[c, s], [-s, c]]), b[:2] - a[:2]
    J = np.zeros((3, 6))
    J[:2, :2], J[:2, 3:5], J[:2, 2] = -back, back, np.array([[-s, c], [-c, -s]]) @ step
    J[2, 2], J[2, 5] = -1.0, 1.0
    to_end = Pose(theta=-motion[2]).adjoint()
    return to_end @ J, to_end @ np.array([*(back @ step - motion[:2]), wrap_angle(b[2] - a[2] - motion[2])])


def tour_row(scene: str, seeds: int, label: str, **fields: Any) -> list[str]:
    """Tours of a scene; their row."""
    ate, nees, times = [], [], []
    for seed in range(seeds):
        run = ss.run(scene, task="tour", seed=seed, max_time=TOUR_S, progress=False, **fields)
        ate.append(run.metrics["ate_rmse_m"])
        nees.append(run.metrics["pose_nees_world_mean"])
        times.append(run.metrics["scan_ms_p50"])
    mean = [f"{1e3 * np.mean(ate):.1f}", f"{1e3 * np.max(ate):.1f}", f"{np.mean(nees):.2f}"]
    return [f"{scene}, {seeds} seeds", label, *mean, f"{np.mean(times):.1f}"]


def log_row(name: str, data: Path, label: str, **fields: Any) -> list[str]:
    """Replay a log; its row."""
    log, relations = data / name / f"{name}.clf.bz2", data / name / f"{name}.relations"
    metrics = ss.replay(log, relations=relations, progress=False, **fields).metrics
    found = [f"{metrics[f'relations_{key}']:.4f}" for key in ("trans_m_mean", "rot_deg_mean")]
    return [name, label, *found, f"{metrics['scan_ms_p50']:.1f}"]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--logs", nargs="*", default=[], choices=LOGS, help="to replay, too (none)")
    parser.add_argument("--tours", nargs="*", default=TOURS, choices=TOURS, help="scenes of the tours (all)")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="of the tours (3)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1)
    scans = {"estimator": "isam2", "scans": {"loop_closures": False}}
    matchers: dict[str, dict[str, Any]] = {
        "small_gicp, keyframe to keyframe": {**scans, "front_end": Gicp},
        "scan matching without loop closures": {**scans, "front_end": "scan-matching"},
    }
    estimators: dict[str, dict[str, Any]] = {
        "least squares, scipy": {"estimator": LeastSquares}, "isam2": {"estimator": "isam2"}
    }  # fmt: skip
    of_tours = [["tour of 120 s", "part", "ATE mm", "largest", "NEES (3)", "ms a keyframe"]]
    of_tours += [
        tour_row(scene, options.seeds, label, **fields)
        for scene in options.tours
        for label, fields in (matchers | estimators).items()
    ]
    of_logs = [["log", "part", "mean m", "mean deg", "ms a keyframe"]]
    data = os.environ.get("SIXTHSENSE_DATA")
    for name in options.logs if data else ():
        of_logs += [log_row(name, Path(str(data)), label, **fields) for label, fields in matchers.items()]
    for name, table in (("foreign_parts", of_tours), ("foreign_logs", of_logs)):
        if len(table) > 1:
            finish(options, name, table, text=2)


if __name__ == "__main__":
    main()
