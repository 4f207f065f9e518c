"""Does the smoother know how well it knows? Relations of real logs against the covariances it states between keyframes.

    SIXTHSENSE_DATA=FOLDER python benchmarks/relation_covariances.py          # about 3 minutes

A relation (Kümmerle et al. 2009) is the motion between two scans as aligned and checked by hand. It has an error of
its own, which nobody has stated: sigmas of position and heading, fitted by maximum likelihood to the logs in `FITTED`,
where the covariances stated between keyframes are taken as they are. The other logs are told with these sigmas. A row
has the share of the relations whose error lies within the ellipsoid of 50, 90 and 95 %, and the mean squared
Mahalanobis distance per degree of freedom, by the way that the robot drove between the two scans. The motion between a
scan and its keyframe is taken as exact.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from harness import arguments, data_path, finish
from scipy.optimize import minimize

from sixthsense.config import preset
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between, compose
from sixthsense.logs.replay_input import of_log, open_recorded
from sixthsense.logs.stamps import matched
from sixthsense.slam.slam import Slam

FITTED, TOLD = ("intel", "fr079"), ("aces", "clinic")
SHARES = (0.5, 0.9, 0.95)
WAYS_M = (0.0, 1.0, 5.0, 50.0, np.inf)
NEAR_S = 5.0
"""Relations of scans no farther apart are short enough that wheels know the motion, too."""
HEAD = ["log", "relations", "stated sigma, m", *(f"within {100 * share:.0f} %" for share in SHARES), "d² / 3"]

HAT = ["relations within 5 s", "number"]
HAT += [f"{what}, {unit}" for unit in ("mm", "mrad") for what in ("stated", "ours", "relations", "wheels")]
HAT += ["within 5 m contradicted by both"]
FAR_M, ALIKE_M = 0.2, 0.1
"""A relation is contradicted by both where it is that far from ours, and wheels are nearer to ours than that."""


class Errors(NamedTuple):
    """Errors of the relations of a log."""

    errors: Array
    """(R, 3) x, y, heading in the frame of the first scan, m and rad"""
    stated: Array
    """(R, 3, 3) covariances that the smoother states"""
    ways_m: Array
    """(R,) that the robot drove between the two scans, as estimated"""
    of_wheels: Array
    """(R, 3) the same errors of the log's own odometry"""
    passed_s: Array
    """(R,) between the two scans"""

    def squared(self, sigmas: Array) -> Array:
        """(R,) squared Mahalanobis distances, with the sigmas (2,) of the relations' own position and heading."""
        covs = self.stated + np.diag(np.append(np.repeat(sigmas[:1], 2), sigmas[1]) ** 2)
        return np.asarray(np.einsum("ri,rij,rj->r", self.errors, np.linalg.inv(covs), self.errors))

    def log_likelihood(self, sigmas: Array) -> float:
        """Of Gaussian errors, but for a constant."""
        covs = self.stated + np.diag(np.append(np.repeat(sigmas[:1], 2), sigmas[1]) ** 2)
        return -0.5 * float((self.squared(sigmas) + np.linalg.slogdet(covs)[1]).sum())


def errors_of(name: str) -> Errors:
    """Map a log with the defaults, and compare it with its relations."""
    folder = data_path(name)
    file = next(file for file in folder.iterdir() if file.suffix in (".bz2", ".bag"))
    found = open_recorded(file, preset("log"), folder / f"{name}.relations")
    log, relations = found.log, found.relations
    assert relations is not None
    stamps, keys, wheels, key = [], [], [], 0
    with Slam(of_log(preset("log"), log), log.start, draws_map=False) as slam:
        for tick in log.ticks:
            step = slam.take(tick)
            key = key if step.keyframe is None else step.keyframe.index
            if tick.scan is not None:
                stamps.append(tick.log_stamp_s)
                keys.append(key)
                wheels.append(tick.odometry.array())
        result = slam.finish()
        rows = matched(stamps, relations.stamps)
        covs = slam.relative_covariances(np.array(keys)[rows])
    assert result.since_key is not None
    poses = compose(result.trajectory[keys], result.since_key)
    driven_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    return Errors(
        _off(relations.poses, poses[rows]),
        covs,
        np.abs(np.diff(driven_m[rows]))[:, 0],
        _off(relations.poses, np.array(wheels)[rows]),
        np.abs(np.diff(np.array(stamps)[rows]))[:, 0],
    )


def _off(relations: Array, ends: Array) -> Array:
    """(R, 3) errors of the motions between poses (R, 2, 3), in the frames of the second ones."""
    return between(relations, between(ends[:, 0], ends[:, 1]))


def fitted(logs: Sequence[Errors]) -> Array:
    """(2,) sigmas of position, m, and of heading, rad, of the relations themselves."""

    def cost(log_sigmas: Array) -> float:
        return -sum(one.log_likelihood(np.exp(log_sigmas)) for one in logs)

    return np.asarray(np.exp(minimize(cost, np.log([0.02, 0.01]), method="Nelder-Mead").x))


def rows_of(name: str, errors: Errors, sigmas: Array) -> list[list[str]]:
    """All relations of a log, and those of ways of about the same length."""
    squared, found = errors.squared(sigmas), []
    sigma_m = np.sqrt(0.5 * np.trace(errors.stated[:, :2, :2], axis1=1, axis2=2))
    spans = [(0.0, np.inf), *itertools.pairwise(WAYS_M)]
    for low, high in spans:
        chosen = (errors.ways_m >= low) & (errors.ways_m < high)
        if not chosen.any():
            continue
        span = f"{low:g} to {high:g} m" if np.isfinite(high) else f"over {low:g} m"
        what = name if (low, high) == (0.0, np.inf) else span
        within = [float((squared[chosen] <= chi_square_quantile(share, 3)).mean()) for share in SHARES]
        found.append([
            what, str(int(chosen.sum())), f"{np.median(sigma_m[chosen]):.3f}",
            *(f"{100 * share:.1f}" for share in within), f"{squared[chosen].mean() / 3.0:.2f}",
        ])  # fmt: skip
    return found


def hat(errors: Errors) -> Array:
    """(3, 3) robust sigmas along the first scan, across it and of heading: of ours, of the relations and of wheels.

    The three-cornered hat (Gray and Allan 1974) over relations of near scans: if the three are independent, the
    variances of their differences give each one's own. A variance below zero says that they are not; it is NaN here.
    """
    near = errors.passed_s <= NEAR_S
    ours, wheels = errors.errors[near], errors.of_wheels[near]
    a, b, c = ((np.median(np.abs(off), axis=0) / 0.6745) ** 2 for off in (ours, wheels, ours - wheels))
    own = 0.5 * np.array([a + c - b, a + b - c, b + c - a])
    return np.sqrt(np.where(own > 0.0, own, np.nan))


def hat_row(name: str, errors: Errors) -> list[str]:
    """Position, mm, and heading, mrad, of the three, beside what the smoother states."""
    near = errors.passed_s <= NEAR_S
    stated = np.sqrt(np.median(np.diagonal(errors.stated[near], axis1=1, axis2=2), axis=0))
    rows = [np.hypot(one[0], one[1]) / math.sqrt(2.0) for one in (stated, *hat(errors))]
    turns = [one[2] for one in (stated, *hat(errors))]
    cells = ["correlated" if np.isnan(value) else f"{1e3 * value:.1f}" for value in (*rows, *turns)]
    short = errors.ways_m <= WAYS_M[2]
    far, apart = (np.hypot(*off[short, :2].T) for off in (errors.errors, errors.errors - errors.of_wheels))
    return [name, str(int(near.sum())), *cells, str(int(((far > FAR_M) & (apart < ALIKE_M)).sum()))]


def main() -> None:
    """Measure, fit and print."""
    options = arguments(__doc__).parse_args()
    logs = {name: errors_of(name) for name in (*FITTED, *TOLD)}
    sigmas = fitted([logs[name] for name in FITTED])
    HEAD[1] = f"relations, themselves {1e3 * sigmas[0]:.0f} mm and {1e3 * sigmas[1]:.0f} mrad"
    rows = [row for name, one in logs.items() for row in rows_of(name, one, sigmas)]
    finish(options, "relation_covariances", [HEAD, *rows], [HAT, *(hat_row(name, one) for name, one in logs.items())])


if __name__ == "__main__":
    main()
