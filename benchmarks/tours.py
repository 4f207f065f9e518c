"""Shared by the benchmarks of tours: runs evaluated against the truth, one row each, resumable, in several processes.

A campaign keeps the metrics of a run. These benchmarks need NEES at every keyframe and every match as well, which only
the trace has.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from harness import check_at_least, kept, pooled, run
from repetition_scenes import out_and_back

from sixthsense.campaigns.plan import config_hash
from sixthsense.config import Config, load_config, merge, preset
from sixthsense.config.platform import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Command
from sixthsense.evaluation.matches import discarded_share, judge_matches
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.metrics import full_rank_from, nees_band, nees_invariant, nees_world, share_in_band
from sixthsense.evaluation.true_identities import TrueLaser, true_identities
from sixthsense.record.trace import Trace
from sixthsense.running.warmup import warm_up
from sixthsense.slam.slam import Slam
from sixthsense.sources.mission import mission
from sixthsense.sources.scene import load_scene
from sixthsense.sources.world import World

Row = dict[str, Any]

MATCHES = ("wrong", "spanning", "unexplained", "left_out")
"""what a match can be, beside right"""

NEES = ("nees3", "nees3_invariant", "nees_position", "nees_heading")
"""NEES of the pose in world and right-invariant coordinates (3 if consistent), of position (2) and heading (1)"""

TURNING_S, CORRIDOR_M = 20.0, 6.0
"""of short drives: time of turning to and fro, and way along a corridor"""


def tour(scene: str, estimator: str, name: str, seconds: float, file: Path | None = None, **fields: Any) -> Config:
    """The configuration of a tour for seed 0: the preset `name`, the partial configuration in `file`, then `fields`.

    Raises InputError for a value that is not allowed.
    """
    config = preset(name)
    if file is not None:
        config = dataclasses.replace(load_config(file, config), preset=name)
    config = merge(config, {"scene": scene, "estimator": estimator, "task": "tour", "max_time": seconds, **fields})
    mission(load_scene(scene), config)
    return config


def judge(trace: Trace) -> Row:
    """Evaluate a run: errors, matches against the truth, NIS, and the NEES at each keyframe after its update.

    NEES is None before the covariance has full rank.
    """
    metrics = measure(trace)
    truths = np.array(trace.key_truths)
    row: Row = {key: metrics[key] for key in ("outcome", "collisions", "sim_time_s", "realtime_factor")}
    row["landmarks"] = len(trace.records)
    row |= {key: metrics[key] for key in ("ate_rmse_m", "ate_max_m", "heading_rmse_rad", "scan_ms_p99")}
    row |= judged_matches(trace)
    row["keyframes"] = len(truths)
    poses = np.array([e.pose.array() for e in trace.key_estimates])
    covs = np.array([e.pose_cov for e in trace.key_estimates])
    for name, values in keyframe_nees(poses, truths, covs).items():
        row[name] = [None if math.isnan(v) else round(v, 5) for v in values.tolist()]
    return row


def judged_matches(trace: Trace) -> Row:
    """NIS of a run, and its matches judged by the truth."""
    assert trace.scene is not None
    laser = TrueLaser(trace.config.laser, trace.config.assumed.laser)
    scene, truths = true_identities(trace.scene.walls), np.array(trace.key_truths)
    matches = judge_matches([a.observations for a in trace.associations], truths, scene, laser)
    row: Row = {"nis": sum(a.nis for a in trace.associations), "nis_dof": sum(a.dof for a in trace.associations)}
    row |= {"observations": matches.observations, "discarded_share": discarded_share(trace.associations)}
    return row | {name: len(getattr(matches, name)) for name in MATCHES}


def keyframe_nees(poses: Array, truths: Array, covs: Array) -> dict[str, Array]:
    """Each kind of NEES (K,) of poses (K, 3); NaN before the world-frame covariance (K, 3, 3) has full rank."""
    out = {name: np.full(len(poses), math.nan) for name in NEES}
    first = full_rank_from(covs)
    if first == len(poses):
        return out
    error, cov = (poses - truths)[first:], covs[first:]
    out["nees3"][first:] = nees_world(error, cov)
    out["nees3_invariant"][first:] = nees_invariant(poses[first:], truths[first:], cov)
    solved = np.linalg.solve(cov[:, :2, :2], error[:, :2, None])[:, :, 0]
    out["nees_position"][first:] = np.einsum("ki,ki->k", error[:, :2], solved)
    turn = (error[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    out["nees_heading"][first:] = turn**2 / cov[:, 2, 2]
    return out


def short_drive(where: str, config: Config) -> float:
    """Mean NEES over the keyframes of a drive of some seconds by given commands.

    `standing` turns to and fro at the start of `apartment`, since a robot without any motion gets no keyframe.
    `corridor` drives straight along a corridor with few doors, drawn by the seed as the place in it.
    """
    robot, rng = config.robot, np.random.default_rng(config.seed)
    if where == "standing":
        scene = load_scene("apartment")
        assert scene.start is not None
        walls, start = scene.walls, scene.start
        phases = np.arange(0.0, TURNING_S, robot.control_period_s) % 4.0  # a second left, two right, a second left
        commands = [Command(turn_rate=robot.turn_rate * (-1.0 if 1.0 <= phase < 3.0 else 1.0)) for phase in phases]
    else:
        walls, ((near, middle), (far, _), *_) = out_and_back(rng)
        start = Pose(rng.uniform(near + CORRIDOR_M, far - 2.0 * CORRIDOR_M), middle)
        commands = [Command(robot.speed)] * round(CORRIDOR_M / robot.speed / robot.control_period_s)
    world = World(walls, start, DEFAULT_ROBOT_RADIUS_M, config, random_streams(config.seed).world)
    estimates, truths = [], []
    with Slam(config, start) as slam:
        for command in commands:
            tick = world.step(command)
            if tick is None or tick.truth is None:
                raise RuntimeError(f"{where}, seed {config.seed}: found a collision, allowed: a free way")
            if (keyframe := slam.take(tick).keyframe) is not None:
                estimates.append(keyframe.estimate)
                truths.append(tick.truth.array())
    poses, covs = np.array([e.pose.array() for e in estimates]), np.array([e.pose_cov for e in estimates])
    return float(np.nanmean(keyframe_nees(poses, np.array(truths), covs)["nees3"]))


def make_row(config: Config) -> Row:
    """Run a configuration and evaluate it."""
    return row_of(config, run(config).trace)


def row_of(config: Config, trace: Trace) -> Row:
    """The evaluation of a run, with what distinguishes it from others."""
    return {**{name: getattr(config, name) for name in ("scene", "estimator", "preset", "seed")}, **judge(trace)}


def rows(
    configs: Sequence[Config], jobs: int, folder: Path | None = None, make: Callable[[Config], Row] = make_row
) -> list[Row]:
    """A row per configuration, in order, which `make` computes in one of `jobs` processes.

    With a `folder`, rows are saved there, and a run whose row it has is not repeated.
    """
    return list(pooled(partial(_row, folder, make), configs, jobs, warm_up))


def _row(folder: Path | None, make: Callable[[Config], Row], config: Config) -> Row:
    if folder is None:
        return make(config)
    name = f"{Path(config.scene).stem}-{config.preset}-{config.estimator}-{config.seed:03d}-{config_hash(config)}"
    return kept(folder / f"{name}.json", lambda: make(config))


COLUMNS = (
    ("runs", "runs", ".0f"),
    ("ended", "tour_ended", ".0f"),
    ("NEES", "nees3", ".2f"),
    ("±", "nees3_se", ".2f"),
    ("invariant", "nees3_invariant", ".2f"),
    ("of position", "nees_position", ".2f"),
    ("of heading", "nees_heading", ".2f"),
    ("in band", "share_in_band", ".2f"),
    ("NIS/dof", "nis_per_dof", ".3f"),
    ("wrong/1000", "wrong_per_1000", ".3f"),
    ("spanning/1000", "spanning_per_1000", ".2f"),
    ("unexplained/1000", "unexplained_per_1000", ".2f"),
    ("left out/1000", "left_out_per_1000", ".2f"),
    ("discarded", "discarded_share", ".4f"),
    ("ATE m", "ate_median_m", ".4f"),
    ("max", "ate_max_m", ".4f"),
)
"""column name, key of `tour_figures`, and format"""


def tour_figures(found: Sequence[Row]) -> dict[str, float]:
    """Figures of runs that differ only in their seed.

    The NEES are the mean over the keyframes of a run, then over runs, `nees3_se` the standard error over runs.
    `share_in_band` is the share of keyframes, by their number in the run, at which the mean over runs lies in the 95 %
    band for that number of runs; successive keyframes are correlated.
    """
    figures: dict[str, float] = {"runs": len(found)}
    figures["tour_ended"] = sum(row["outcome"] == "tour ended" for row in found)
    figures |= {name: float(np.mean([nees_of(row, name) for row in found])) for name in NEES}
    nees = np.array([nees_of(row) for row in found])
    figures["nees3_se"] = float(nees.std(ddof=1) / math.sqrt(len(nees))) if len(nees) > 1 else math.nan
    steps = over_runs(found, "nees3")
    figures["share_in_band"] = share_in_band(steps[~np.isnan(steps)], nees_band(len(found)))
    figures["nis_per_dof"] = sum(row["nis"] for row in found) / max(sum(row["nis_dof"] for row in found), 1)
    observations = max(sum(row["observations"] for row in found), 1)
    figures |= {f"{name}_per_1000": 1e3 * sum(row[name] for row in found) / observations for name in MATCHES}
    figures["discarded_share"] = float(np.mean([row["discarded_share"] for row in found]))
    errors = [row["ate_rmse_m"] for row in found]
    return figures | {"ate_median_m": float(np.median(errors)), "ate_max_m": float(np.max(errors))}


def table(found: Sequence[Row], names: Sequence[str], estimators: Sequence[str]) -> list[list[str]]:
    """A row per scene and estimator, and one of all scenes together."""
    lines = [["scene", "estimator", *(head for head, *_ in COLUMNS)]]
    of_all = [("all", estimator) for estimator in estimators] if len(names) > 1 else []
    for name, estimator in [*itertools.product(names, estimators), *of_all]:
        values = tour_figures([r for r in found if r["estimator"] == estimator and name in ("all", r["scene"])])
        lines.append([Path(name).stem, f"`{estimator}`", *(format(values[key], form) for _, key, form in COLUMNS)])
    return lines


def add_tour_options(parser: argparse.ArgumentParser, seeds: int) -> None:
    """Add the options that all benchmarks of tours have."""
    parser.add_argument("--seeds", type=int, default=seeds, metavar="N", help=f"number of seeds ({seeds})")
    parser.add_argument("--first-seed", type=int, default=0, metavar="S", help="the first seed (0)")
    parser.add_argument("--max-time", type=float, default=400.0, metavar="S", help="simulated seconds (400)")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    parser.add_argument("--rows", type=Path, metavar="DIR", help="save a row per run there, and skip saved runs")
    parser.add_argument("--config", type=Path, metavar="FILE", help="partial configuration, merged into the preset")


def check_tour_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """End the program with one line for a number that is too small."""
    check_at_least(parser, options, seeds=1, first_seed=0, jobs=1, max_time=1.0)


def seeded(configs: Sequence[Config], options: argparse.Namespace) -> list[Config]:
    """Each configuration with each seed, ordered by seed, so that an interrupted benchmark has all settings alike."""
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    return [dataclasses.replace(config, seed=seed) for seed in seeds for config in configs]


def over_runs(rows: Sequence[Row], name: str) -> Array:
    """(K,) mean over runs of a kind of NEES at the k-th keyframe of each, NaN where no run has a value."""
    longest = max(len(row[name]) for row in rows)
    values = np.full((len(rows), longest), math.nan)
    for k, row in enumerate(rows):
        values[k, : len(row[name])] = [math.nan if v is None else v for v in row[name]]
    known = ~np.isnan(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0))


def nees_of(row: Row, name: str = "nees3") -> float:
    """Mean over the keyframes of one run of a kind of NEES."""
    return float(np.nanmean(np.array([math.nan if v is None else v for v in row[name]])))
