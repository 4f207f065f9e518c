"""Runs in a row, each beginning with the map of the one before.

    python benchmarks/prior_maps.py --scene apartment --estimator ekf-invariant --seeds 10

Run k of chain s has seed 1000 + 100 s + k. Each explores the whole scene from its start, exactly known, or drawn with
`--pose-sigma`. The figures are the median landmark error of the last run over that of the first, and NEES of pose (3 is
consistent) and landmarks (2), pooled over the chains, run by run. With `--changed` three walls are moved and a door is
closed after the first run; a change is followed when the cells of the old wall are free, those of the new one are
obstacles, and no landmark is left on the old one.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from harness import arguments, check_at_least, pooled

from sixthsense.config import preset
from sixthsense.core.geometry import Array
from sixthsense.evaluation import metrics
from sixthsense.evaluation.matches import landmark_identities
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.true_identities import TrueLaser, true_identities
from sixthsense.record.prior_map import prior_start
from sixthsense.record.trace import Trace
from sixthsense.running.runs import Watch, reserved, simulate
from sixthsense.sources.scene import Scene, load_scene

Segment = tuple[float, float, float, float]


class Change(NamedTuple):
    """A wall before and after; a door that is closed has none before."""

    before: Segment | None
    after: Segment


CHANGES = {
    "apartment": (
        Change((3.7, 0.9, 3.7, 2.6), (4.5, 0.9, 4.5, 2.6)),
        Change((1.8, 4.2, 1.8, 3.3), (2.6, 4.2, 2.6, 3.3)),
        Change((12.0, 9.0, 12.0, 7.9), (12.6, 9.0, 12.6, 7.9)),
        Change(None, (9.5, 4.2, 10.3, 4.2)),
    ),
    "office": (
        Change((25.0, 0.0, 25.0, 3.6), (24.0, 0.0, 24.0, 3.6)),
        Change((22.0, 14.5, 22.0, 18.2), (21.2, 14.5, 21.2, 18.2)),
        Change((10.0, 1.9, 10.0, 5.5), (9.2, 1.9, 9.2, 5.5)),
        Change(None, (4.0, 14.5, 4.9, 14.5)),
    ),
}
_ENDS_M = 0.3
"""of a wall that is not judged: other walls meet it there"""


class Chain(NamedTuple):
    """Runs in a row."""

    scene: str
    estimator: str
    seed: int
    runs: int
    changed: bool
    sigma: tuple[float, float, float] | None


def changed_scene(scene: Scene) -> Scene:
    """The scene after its changes."""
    walls = scene.walls
    for before, after in CHANGES[scene.name]:
        if before is not None:
            is_it = (np.abs(walls.reshape(-1, 4) - before) < 1e-9).all(axis=1)
            assert is_it.sum() == 1, f"{before} is not a wall of {scene.name}"
            walls = walls[~is_it]
        walls = np.concatenate([walls, np.reshape(after, (1, 2, 2))])
    return dataclasses.replace(scene, walls=walls)


def rows_of(chain: Chain) -> list[dict[str, Any]]:
    """A row for each run of a chain."""
    return list(_driven(chain))


def _driven(chain: Chain) -> Iterator[dict[str, Any]]:
    plain = load_scene(chain.scene)
    with tempfile.TemporaryDirectory() as folder:
        for k in range(chain.runs):
            seed = 1000 + 100 * chain.seed + k
            config = preset(scene=chain.scene, estimator=chain.estimator, seed=seed)
            scene = changed_scene(plain) if chain.changed and k else plain
            pose = None
            if k and chain.sigma is not None and plain.start is not None:
                error = np.array(chain.sigma) * np.random.default_rng(seed).standard_normal(3)
                pose = (plain.start.array() + error).tolist()
            prior = prior_start(f"{folder}/{k - 1}", pose, chain.sigma if pose else None) if k else None
            with reserved(f"{folder}/{k}", config, prior=prior) as out:
                trace = simulate(config, scene, out, Watch(progress=False), prior).trace
            row = {"scene": chain.scene, "estimator": chain.estimator, "seed": chain.seed, "run": k, **judged(trace)}
            if chain.changed and k:
                row["followed"] = [follows(trace, change) for change in CHANGES[chain.scene]]
            yield row


def judged(trace: Trace) -> dict[str, Any]:
    """Errors and NEES of a run."""
    found = measure(trace)
    scene = trace.scene
    assert scene is not None
    known, laser = true_identities(scene.walls), TrueLaser(trace.config.laser, trace.config.assumed.laser)
    observations = [association.observations for association in trace.associations]
    identities = landmark_identities(observations, np.array(trace.key_truths), known, laser)
    rows = [k for k, i in enumerate(trace.final.ids.tolist()) if i in identities]
    truth = np.array([known.landmark(identities[i]) for i in trace.final.ids[rows].tolist()])
    walls = trace.final.walls[rows]
    covs = np.array([trace.joint_cov[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k] for k in rows])
    nees = metrics.nees_landmarks(trace.final.landmarks[rows], truth, walls, covs)
    extents = np.array([trace.records[i].extent for i in trace.final.ids[rows].tolist()])
    errors = _errors_m(trace.final.landmarks[rows], truth, walls, extents)
    return {
        "outcome": found["outcome"],
        "collisions": found["collisions"],
        "landmarks": found["landmarks"],
        "landmark_error_m": float(np.median(errors)),
        "sigma_m": float(np.median(_sigmas_m(covs, walls, extents))),
        "landmark_nees": float(nees.mean()),
        "pose_nees": found["pose_nees_world_mean"],
        "ate_rmse_m": found["ate_rmse_m"],
        "coverage": found["coverage"],
        "sim_time_s": found["sim_time_s"],
        "scan_ms_p99": found["scan_ms_p99"],
    }


def _errors_m(found: Array, truth: Array, walls: Array, extents: Array) -> Array:
    """(n,) of a point its distance, of a wall that of the middle of its extent from the true line."""
    middle = extents.mean(axis=1)
    normal = np.column_stack([np.cos(truth[:, 0]), np.sin(truth[:, 0])])
    of_walls = np.abs((normal * middle).sum(axis=1) - truth[:, 1])
    return np.where(walls, of_walls, np.hypot(*(found - truth).T))


def _sigmas_m(covs: Array, walls: Array, extents: Array) -> Array:
    """(n,) stated sigma of a point, or of the middle of a wall across it."""
    middle = extents.mean(axis=1)
    direction = extents[:, 1] - extents[:, 0]
    along = np.einsum("nk,nk->n", middle, direction) / np.maximum(np.hypot(*direction.T), 1e-9)
    by = np.column_stack([-along, np.ones(len(covs))])
    across = np.einsum("nk,nkl,nl->n", by, covs, by)
    return np.sqrt(np.where(walls, across, np.trace(covs, axis1=1, axis2=2)))


def follows(trace: Trace, change: Change) -> bool:
    """Whether the map at the end of a run shows a change."""
    is_new = np.mean(_occupied(trace, change.after)) >= 0.9
    if change.before is None:
        return bool(is_new)
    return bool(is_new and np.mean(_occupied(trace, change.before)) <= 0.1 and not _landmarks_on(trace, change.before))


def _occupied(trace: Trace, segment: Segment) -> Array:
    """Whether there is an obstacle within a cell of each point along a wall."""
    grid = trace.grid
    assert grid is not None
    obstacles, origin, cell_m = grid.obstacles, np.array(grid.origin), trace.config.grid.cell_m
    a, b = np.reshape(segment, (2, 2))
    length = float(np.hypot(*(b - a)))
    along = np.arange(_ENDS_M, length - _ENDS_M, cell_m) / length
    cols, rows = np.floor((a + along[:, None] * (b - a) - origin) / cell_m).astype(np.int64).T
    return np.array([obstacles[r - 1 : r + 2, c - 1 : c + 2].any() for r, c in zip(rows, cols, strict=True)])


def _landmarks_on(trace: Trace, segment: Segment) -> int:
    """Number of walls in the map that lie on a wall of the scene."""
    a, b = np.reshape(segment, (2, 2))
    along = (b - a) / np.hypot(*(b - a))
    across = np.array([-along[1], along[0]])
    count = 0
    for i, wall in zip(trace.final.ids.tolist(), trace.final.walls.tolist(), strict=True):
        if not wall:
            continue
        off, place = (trace.records[i].extent - a) @ across, np.sort((trace.records[i].extent - a) @ along)
        overlap = min(place[1], float((b - a) @ along)) - max(place[0], 0.0)
        count += bool(np.abs(off).max() < 0.15 and overlap > _ENDS_M)
    return count


def summary(rows: list[dict[str, Any]], runs: int) -> dict[str, float]:
    """Figures over all chains, run by run."""
    out: dict[str, float] = {}
    for k in range(runs):
        of_run = [row for row in rows if row["run"] == k]
        for key in ("landmark_error_m", "sigma_m", "landmark_nees", "pose_nees", "landmarks", "scan_ms_p99"):
            out[f"run {k + 1}, {key}"] = float(np.mean([row[key] for row in of_run]))
        changes = [done for row in of_run for done in row.get("followed", ())]
        if changes:
            out[f"run {k + 1}, followed"] = float(np.mean(changes))
    first, last = ([row["landmark_error_m"] for row in rows if row["run"] == k] for k in (0, runs - 1))
    out["median landmark error, last / first"] = float(np.median(last) / np.median(first))
    out["collisions"] = float(sum(row["collisions"] for row in rows))
    return out


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--scene", choices=sorted(CHANGES), default="apartment")
    parser.add_argument("--estimator", default="ekf-invariant")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--changed", action="store_true", help="move three walls and close a door after the first run")
    parser.add_argument("--pose-sigma", type=float, nargs=3, metavar=("SX", "SY", "STHETA"))
    parser.add_argument("--rows", type=Path, metavar="FILE", help="append a JSON line for each run")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1, runs=2, jobs=1)
    sigma = None if options.pose_sigma is None else tuple(options.pose_sigma)
    chains = [
        Chain(options.scene, options.estimator, seed, options.runs, options.changed, sigma)
        for seed in range(options.seeds)
    ]
    rows: list[dict[str, Any]] = []
    for found in pooled(rows_of, chains, options.jobs):
        rows += found
        if options.rows is not None:
            with options.rows.open("a", encoding="utf-8") as stream:
                stream.writelines(f"{json.dumps(row)}\n" for row in found)
    figures = summary(rows, options.runs)
    for key, value in figures.items():
        print(f"{key:45} {value:.4g}")
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
