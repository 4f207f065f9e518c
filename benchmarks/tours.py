"""Shared by the benchmarks of tours: runs evaluated against the truth, one row each, resumable, in several processes.

A campaign keeps the metrics of a run. These benchmarks need NEES at every keyframe and every match as well, which only
the trace has.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import check_at_least, pooled, run
from repetition_scenes import out_and_back

from sixthsense.campaigns.plan import config_hash
from sixthsense.config import Config, load_config, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.config.platform import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Command
from sixthsense.evaluation.matches import discarded_share, judge_matches
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.metrics import full_rank_from, nees_invariant, nees_world
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
    names = ("scene", "estimator", "preset", "seed")
    return {**{name: getattr(config, name) for name in names}, **judge(run(config).trace)}


def rows(
    configs: Sequence[Config], jobs: int, folder: Path | None = None, make: Callable[[Config], Row] = make_row
) -> list[Row]:
    """A row per configuration, in order, which `make` computes in one of `jobs` processes.

    With a `folder`, rows are saved there, and a run whose row it has is not repeated.
    """
    files = [None if folder is None else folder / f"{_name(config)}.json" for config in configs]
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    found: dict[int, Row] = {k: json.loads(f.read_text()) for k, f in enumerate(files) if f is not None and f.exists()}
    due = [k for k in range(len(configs)) if k not in found]
    for k, row in zip(due, pooled(make, [configs[k] for k in due], jobs, warm_up), strict=True):
        found[k] = row
        file = files[k]
        if file is not None:
            aside = file.with_suffix(".partial")
            aside.write_text(json.dumps(row) + "\n")
            aside.replace(file)
    return [found[k] for k in range(len(configs))]


def _name(config: Config) -> str:
    name = f"{Path(config.scene).stem}-{config.preset}-{config.estimator}-{config.features.landmarks}"
    return f"{name}-{config.seed:03d}-{config_hash(config)}"


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


__all__ = [
    "MATCHES", "NEES", "InputError", "Row", "add_tour_options", "check_tour_options", "judge", "judged_matches",
    "keyframe_nees", "make_row", "nees_of", "over_runs", "rows", "seeded", "short_drive",
    "tour",
]  # fmt: skip
