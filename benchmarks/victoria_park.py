"""Victoria Park with known landmarks: the estimator `isam2` against direct calls of GTSAM's ISAM2.

The log comes with GTSAM: 6,969 poses and 3,640 observations of 151 trees. As in a replay, a step is a pose with an
observation, and odometry between two steps is composed into one motion. Both sides have the same factors, noise,
initial values and parameters.

Timed for the estimator: `predict`, `update` and `estimate`, which returns the pose, its covariance and all landmarks.
Timed for the direct calls (`by_hand`): construction of the factors, `ISAM2.update`, and reading the same three results
by `calculateEstimate`, `marginalCovariance` and the landmarks as an array; `pose_only` omits the last two. The sides
alternate step by step, and so does their order.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from harness import Figures, arguments, check_at_least, machine, print_table, single_threaded, write_json

from sixthsense.config import ISAM2Config, preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.figures.plot import CYCLE, ODOMETRY, new_figure, save
from sixthsense.slam.estimators import ESTIMATORS, Estimator, make_estimator
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.slam.estimators.isam2_solver import solver_parameters
from sixthsense.sources.logs.graph import read_graph
from sixthsense.sources.logs.log import Log

FILE = Path(gtsam.__file__).parent / "Data" / "victoria_park.txt"
FLOOR = 1e-6  # m, rad; sigma that isam2 adds to every motion, so that an exact start is not singular


@dataclass(frozen=True, slots=True)
class Step:
    """A pose with an observation, as objects of this package and as numbers for GTSAM."""

    odometry: Odometry
    """motion since the previous step"""
    observations: Mapping[LandmarkId, Observation]
    motion: tuple[float, float, float]
    motion_cov: Array
    """(3, 3), in the frame of the robot after the motion"""
    seen: tuple[tuple[LandmarkId, float, float, Array], ...]
    """landmark, bearing, range, and their covariance (2, 2)"""


def steps_of(log: Log) -> list[Step]:
    """The steps of a log whose ticks have the covariance of their motion."""
    steps, since, before = [], STANDSTILL, log.ticks[0].odometry
    for tick in log.ticks:
        if tick.increment_cov is not None:
            since = since.then(Odometry(before.inverse() @ tick.odometry, tick.increment_cov))
        before = tick.odometry
        if tick.observations:
            cov = since.cov_after() + FLOOR**2 * np.eye(3)
            seen = tuple((i, *observation.bearing_range()) for i, observation in tick.observations.items())
            motion = (since.motion.x, since.motion.y, since.motion.theta)
            steps.append(Step(since, tick.observations, motion, cov, seen))
            since = STANDSTILL
    return steps


class ByHand:
    """Direct calls of GTSAM's ISAM2."""

    def __init__(self, config: ISAM2Config, pose_only: bool = False) -> None:
        self.isam = gtsam.ISAM2(solver_parameters(config))
        self._config, self._pose_only = config, pose_only
        self._poses = 0
        self._pose = gtsam.Pose2()
        self._known: set[LandmarkId] = set()

    def step(self, step: Step) -> object:
        """Add a step and read the result."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        motion = gtsam.Pose2(*step.motion)
        noise = gtsam.noiseModel.Gaussian.Covariance(step.motion_cov)
        key = X(self._poses)
        if self._poses == 0:
            graph.add(gtsam.PriorFactorPose2(key, motion, noise))
        else:
            graph.add(gtsam.BetweenFactorPose2(key - 1, key, motion, noise))
        guess = self._pose.compose(motion)
        values.insert(key, guess)
        self._poses += 1
        for i, bearing, distance, cov in step.seen:
            noise = gtsam.noiseModel.Gaussian.Covariance(cov)
            graph.add(gtsam.BearingRangeFactor2D(key, L(i), gtsam.Rot2(bearing), distance, noise))
            if i not in self._known:
                self._known.add(i)
                at = distance * np.array([np.cos(bearing), np.sin(bearing)])
                values.insert(L(i), guess.transformFrom(at))
        self.isam.update(graph, values)
        linearised = guess
        for _ in range(self._config.iterations - 1):
            solved = self.isam.calculateEstimatePose2(key)
            if np.abs(linearised.localCoordinates(solved)).max() <= self._config.relinearize_threshold:
                break
            self.isam.update()
            linearised = solved
        if self._pose_only:
            self._pose = self.isam.calculateEstimatePose2(key)
            return self._pose
        estimate = self.isam.calculateEstimate()
        self._pose = estimate.atPose2(key)
        return self._pose, self.isam.marginalCovariance(key), gtsam.utilities.extractPoint2(estimate)

    def graph_error(self) -> float:
        """Half the sum of squared whitened residuals."""
        return float(self.isam.getFactorsUnsafe().error(self.isam.calculateEstimate()))


def estimator_step(estimator: Estimator) -> Callable[[Step], object]:
    """The calls of one turn of the loop to an estimator."""

    def step(step: Step) -> object:
        estimator.predict(step.odometry)
        estimator.update(step.observations)
        return estimator.estimate()

    return step


def race(steps: Sequence[Step], *sides: Callable[[Step], object]) -> Array:
    """(steps, sides) milliseconds; the sides alternate in going first."""
    spent = np.zeros((len(steps), len(sides)))
    for k, step in enumerate(steps):
        for turn in range(len(sides)):
            side = (turn + k) % len(sides)
            began = perf_counter()
            sides[side](step)
            spent[k, side] = 1e3 * (perf_counter() - began)
    return spent


def smoother_figures(steps: Sequence[Step], config: ISAM2Config, runs: int) -> tuple[Figures, ISAM2]:
    """Step times and final graph errors of both sides over `runs` races, and the estimator at the end."""
    times, figures = [], Figures()
    for _ in range(runs):
        ours = ISAM2(Pose(), np.zeros((3, 3)), config)
        bare, pose_only = ByHand(config), ByHand(config, pose_only=True)
        times.append(race(steps, estimator_step(ours), bare.step, pose_only.step))
        figures["isam2.graph_error"] = ours.graph_error()
        figures["by_hand.graph_error"] = bare.graph_error()
    for name, column in zip(("isam2", "by_hand", "pose_only"), np.concatenate(times).T, strict=True):
        figures[f"{name}.step_ms_mean"] = float(column.mean())
        figures[f"{name}.step_ms_p99"] = float(np.percentile(column, 99))
    figures["step_ratio"] = figures["isam2.step_ms_mean"] / figures["by_hand.step_ms_mean"]
    figures["step_ratio_pose_only"] = figures["isam2.step_ms_mean"] / figures["pose_only.step_ms_mean"]
    figures["graph_error_ratio"] = figures["isam2.graph_error"] / figures["by_hand.graph_error"]
    return figures, ours


def filter_figures(steps: Sequence[Step], smoothed: Array) -> tuple[Figures, dict[str, Array]]:
    """Each filter's mean step time and distance from the `smoothed` trajectory (K, 3), and the trajectories by name."""
    figures, ways = Figures(), {}
    for name in ESTIMATORS:
        if name == "isam2":
            continue
        estimator, key = make_estimator(name, Pose(), np.zeros((3, 3))), name.replace("-", "_")
        figures[f"{key}.step_ms_mean"] = float(race(steps, estimator_step(estimator)).mean())
        ways[name] = estimator.trajectory()
        gap = np.linalg.norm(ways[name][:, :2] - smoothed[:, :2], axis=1)
        figures[f"{key}.rms_from_smoothed_m"] = float(np.sqrt(np.mean(gap**2)))
    return figures, ways


def draw(log: Log, ways: Mapping[str, Array], trees: Array, file: Path) -> None:
    """Draw trajectories and trees."""
    figure = new_figure(9.0, 9.0)
    ax: Any = figure.add_subplot()
    wheels = np.array([tick.odometry.array() for tick in log.ticks])
    ax.plot(wheels[:, 0], wheels[:, 1], color=ODOMETRY, linewidth=0.7, alpha=0.6, label="dead reckoning")
    styles = {"isam2": ("smoothed: isam2", CYCLE[0], 1.3), "ekf": ("ekf", CYCLE[3], 0.8)}
    for name, (label, color, width) in styles.items():
        ax.plot(ways[name][:, 0], ways[name][:, 1], color=color, linewidth=width, label=label)
    ax.scatter(trees[:, 0], trees[:, 1], s=14, color=CYCLE[1], label=f"{len(trees)} trees, isam2", zorder=5)
    ax.set_aspect("equal")
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    ax.legend(frameon=False)
    ax.set_title("Victoria Park, known landmarks")
    save(figure, file)


def rows(figures: Figures) -> list[list[str]]:
    """The rows of the table."""
    lines = [["", "step ms", "99 % below", "graph error", "m from smoothed"]]
    for name in ("by_hand", "pose_only", *(name.replace("-", "_") for name in ESTIMATORS)):
        cells = [figures.get(f"{name}.{key}") for key in ("step_ms_mean", "step_ms_p99", "graph_error")]
        cells.append(figures.get(f"{name}.rms_from_smoothed_m"))
        label = {"by_hand": "GTSAM directly", "pose_only": "GTSAM directly, pose only"}.get(
            name, name.replace("_", "-")
        )
        lines.append([label, *("" if cell is None else f"{cell:.3f}" for cell in cells)])
    return lines


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--runs", type=int, default=1, metavar="N", help="repetitions to average times over (1)")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the trajectory and the trees, as a PNG")
    options = parser.parse_args()
    check_at_least(parser, options, runs=1)
    log, config = read_graph(FILE), preset("victoria").isam2
    steps = steps_of(log)
    with single_threaded():
        figures, smoother = smoother_figures(steps, config, options.runs)
        smoothed, trees = smoother.trajectory(), smoother.estimate().landmarks
        others, ways = filter_figures(steps, smoothed)
    figures |= others | {"steps": len(steps), "landmarks": len(trees)}
    print(machine())
    print_table(rows(figures))
    print(f"{len(steps)} steps, {len(trees)} landmarks")
    print(
        f"step time of isam2: {figures['step_ratio']:.2f} times that of GTSAM directly (target: at most 1.2), ", end=""
    )
    print(f"{figures['step_ratio_pose_only']:.2f} times GTSAM's with the pose only")
    print(f"graph error: {figures['graph_error_ratio']:.4f} times GTSAM's directly (target: 0.99 to 1.01)")
    if options.figure is not None:
        draw(log, ways | {"isam2": smoothed}, trees, options.figure)
    write_json(options.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
