"""Is the verdict of `sixthsense audit` right? Errors drawn from a known covariance, stated 0.5, 1 and 2 times as large.

A robot drives a circle. Its errors are Gaussian with an anisotropic covariance that is correlated between axes, white
or AR(1), in SE(2) and in SE(3). Each row audits the same seeds:

- A right verdict is overconfident for 0.5, consistent for 1, cautious for 2; the true factor is 2, 1 and 0.5.
- The interval of the factor has 95 %; the ratio of its ends is a median.
- The effective number of samples of AR(1) errors is N (1 - rho^2) / (1 + rho^2) in theory.

The frame is then tested: a covariance that turns with the robot, read in the world's axes; and poses in a wrong frame,
aligned by all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from harness import Figures, arguments, check_at_least, finish, pooled
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import sixthsense as ss
from sixthsense.auditing.result import Audit
from sixthsense.core.geometry import Array

POSES, STEP_S, TURN_RATE = 10_000, 0.1, 0.05
SIGMAS = {3: (0.08, 0.03, 0.01), 6: (0.08, 0.03, 0.05, 0.004, 0.006, 0.01)}
EXPECTED = {0.5: "overconfident", 1.0: "consistent", 2.0: "cautious"}
"""verdict on a covariance so many times the true one"""
CASES = [(rho, dof, stated) for dof in (3, 6) for rho in (0.0, 0.99) for stated in EXPECTED]
FRAMES = (
    "turns with the robot, read in the world's axes",
    "in the world's axes, read so",
    "poses in another frame, aligned by all",
)


HEAD = [
    "errors", "space", "stated covariance", "right verdicts", "interval holds the factor", "mean factor",
    "ends of the interval, ratio", "effective samples, median", "in theory",
]  # fmt: skip


def covariance(dof: int) -> Array:
    """(dof, dof) of the errors: neighbouring axes are correlated by 0.4."""
    correlation = np.eye(dof) + 0.4 * (np.eye(dof, k=1) + np.eye(dof, k=-1))
    return np.asarray(correlation * np.outer(SIGMAS[dof], SIGMAS[dof]))


def errors(rng: np.random.Generator, rho: float, dof: int) -> Array:
    """(POSES, dof) stationary AR(1) errors."""
    white = rng.standard_normal((POSES, dof))
    white[1:] *= math.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], white, axis=0) @ np.linalg.cholesky(covariance(dof)).T)


def circle(dof: int) -> tuple[Array, Array]:
    """Stamps and true poses, (POSES, 3) or (POSES, 7)."""
    stamps_s = STEP_S * np.arange(POSES)
    theta = TURN_RATE * stamps_s
    place = np.column_stack([8.0 * np.sin(theta), -8.0 * np.cos(theta), np.sin(3.0 * theta)])
    if dof == 3:
        return stamps_s, np.column_stack([place[:, :2], theta])
    tilt = Rotation.from_euler("zyx", np.column_stack([theta, 0.2 * np.sin(theta), 0.1 * np.cos(theta)]))
    return stamps_s, np.column_stack([place, tilt.as_quat()])


def erroneous(poses: Array, error: Array) -> Array:
    """Poses with errors in the axes of the world."""
    if error.shape[1] == 3:
        return poses + error
    turned = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_quat(poses[:, 3:])
    return np.column_stack([poses[:, :3] + error[:, :3], turned.as_quat()])


def one_audit(seed: int, case: tuple[float, int, float]) -> tuple[str, float, float, tuple[float, float]]:
    """Outcome, effective samples, factor and its interval of one seed."""
    rho, dof, stated = case
    stamps_s, truth = circle(dof)
    poses = erroneous(truth, errors(np.random.default_rng(seed), rho, dof))
    found = ss.audit(
        (stamps_s, poses, np.broadcast_to(stated * covariance(dof), (POSES, dof, dof))), (stamps_s, truth)
    ).findings
    return found.outcome, found.pose.samples, found.factor, found.pose.interval


def frame_audit(seed: int, case: str) -> Audit:
    """An audit of AR(1) 0.9 errors, with a covariance or poses in a frame of which the audit is not told."""
    rng = np.random.default_rng(seed)
    stamps_s, truth = circle(3)
    error, cov = errors(rng, 0.9, 3), covariance(3)
    if case == FRAMES[0]:
        c, s = np.cos(truth[:, 2]), np.sin(truth[:, 2])
        error = np.column_stack([c * error[:, 0] - s * error[:, 1], s * error[:, 0] + c * error[:, 1], error[:, 2]])
    poses = truth + error
    if case != FRAMES[2]:
        return ss.audit((stamps_s, poses, np.broadcast_to(cov, (POSES, 3, 3))), (stamps_s, truth))
    turn = 0.7
    R = np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    poses = poses @ R.T + np.array([5.0, -2.0, turn])
    covs = np.broadcast_to(R @ cov @ R.T, (POSES, 3, 3))
    return ss.audit((stamps_s, poses, covs), (stamps_s, truth), align="all")


def frame_row(seed: int, case: str) -> tuple[str, bool]:
    """Outcome, and whether the audit says that it may be the other frame."""
    found = frame_audit(seed, case)
    return found.outcome, any("depends on the heading" in note for note in found.notes)


def case_figures(
    case: tuple[float, int, float], rows: Sequence[tuple[str, float, float, tuple[float, float]]]
) -> Figures:
    """The figures of one case over its seeds."""
    rho, _, stated = case
    intervals = np.array([interval for *_, interval in rows])
    return {
        "right": float(sum(outcome == EXPECTED[stated] for outcome, *_ in rows)),
        "held": float(np.sum((intervals[:, 0] <= 1.0 / stated) & (1.0 / stated <= intervals[:, 1]))),
        "effective": float(np.median([samples for _, samples, *_ in rows])),
        "theory": POSES * (1.0 - rho**2) / (1.0 + rho**2),
        "factor": float(np.mean([value for _, _, value, _ in rows])),
        "width": float(np.median(intervals[:, 1] / intervals[:, 0])),
    }


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=100, metavar="N", help="number of seeds, from 0 (100)")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=2, jobs=1)
    seeds = range(options.seeds)
    lines = [HEAD]
    for case in CASES:
        rho, dof, stated = case
        found = case_figures(case, pooled(partial(one_audit, case=case), seeds, options.jobs))
        lines.append(
            [
                f"AR(1) {rho:g}" if rho else "white", f"SE({2 if dof == 3 else 3})", f"× {stated:g}",  # noqa: RUF001
                f"{found['right']:.0f}", f"{found['held']:.0f}", f"{found['factor']:.2f}", f"{found['width']:.2f}",
                f"{found['effective']:,.0f}", f"{found['theory']:,.0f}",
            ]
        )  # fmt: skip
    of_frames = [["covariance and frame", f"consistent, of {options.seeds}", "says that it may be the other frame"]]
    for name in FRAMES:
        rows = pooled(partial(frame_row, case=name), seeds, options.jobs)
        consistent, said = sum(outcome == "consistent" for outcome, _ in rows), sum(other for _, other in rows)
        of_frames.append([name, str(consistent), str(said)])
    finish(options, "covariance_audit", lines, of_frames, text=3)


if __name__ == "__main__":
    main()
