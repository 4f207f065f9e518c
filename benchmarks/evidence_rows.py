"""Rows of the evidence: what is measured, over how many seeds, and one function per kind of row.

A row is a kind, with a setting, over seeds. Its function takes the setting and a seed and returns the figures of one
run. Simulated rows begin at seed 1,000, which no parameter was chosen on. The replay of a log is as the plain command
makes it, with its default seed, which only affects RANSAC.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import kernels
import mrclam
import numpy as np
import victoria_park
from harness import Figures, data_path, replay, run, single_threaded
from tours import tour_figures

import sixthsense as ss
from sixthsense.config import Config, preset
from sixthsense.config.errors import InputError
from sixthsense.evaluation.measure import measure
from sixthsense.logs.graph import read_graph
from sixthsense.logs.mrclam import read_mrclam, true_landmarks
from sixthsense.running.warmup import prepare
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.circle import follow, simulate

FIRST_SEED = 1000
TOUR_S = 200.0

Kind = Literal["tour", "explore", "relations", "mrclam", "victoria", "circle", "kernels"]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the evidence."""

    kind: Kind
    setting: tuple[str, ...]
    """scene and estimator, or log"""
    seeds: int
    """number of seeds at scale 1; 1 where nothing is drawn"""
    needs: str = ""
    """file or folder in SIXTHSENSE_DATA"""

    @property
    def key(self) -> str:
        """Its name in the JSON."""
        return ".".join((self.kind, *self.setting))

    def seed_list(self, scale: float = 1.0) -> list[int]:
        """The seeds of its runs; at least one."""
        if self.seeds == 1:
            return [0]
        first = 0 if self.kind in ("circle", "kernels") else FIRST_SEED
        return list(range(first, first + max(round(self.seeds * scale), 1)))

    def is_possible(self) -> bool:
        """Whether its data is there."""
        return not self.needs or data_path(self.needs).exists()


# The longest first, so that two processes end at about the same time.
ROWS = (
    Row("victoria", (), 1),
    Row("relations", ("intel",), 1, "intel/intel.clf.bz2"),
    Row("relations", ("clinic",), 1, "clinic/clinic.bag"),
    Row("relations", ("fr079",), 1, "fr079/fr079.clf.bz2"),
    Row("relations", ("aces",), 1, "aces/aces.clf.bz2"),
    *(
        Row("tour", (scene, estimator), 20)
        for estimator in ("isam2", "ekf-invariant", "ekf")
        for scene in ("apartment", "office")
    ),
    *(Row("explore", (scene,), 10) for scene in ("office", "loop", "apartment", "block", "rectangle")),
    *(Row("mrclam", (estimator,), 1, "mrclam6") for estimator in ("ekf", "ekf-invariant", "isam2")),
    *(Row("circle", (estimator,), 8 if estimator == "isam2" else 60) for estimator in reversed(ESTIMATORS)),
    Row("kernels", (), 3),
)


def tour_of_scene(setting: tuple[str, ...], seed: int) -> Figures:
    """A tour in closed loop with unknown association."""
    scene, estimator = setting
    found = tour_figures(run(preset(scene=scene, estimator=estimator, task="tour", max_time=TOUR_S, seed=seed)))
    wrong, observations, _ = found.pop("wrong"), found.pop("observations"), found.pop("collisions")
    return found | {"wrong_per_1000": 1e3 * wrong / max(observations, 1)}


def times_real_time(config: Config, of_log: bool, go: Callable[[], ss.Run]) -> tuple[ss.Metrics, float]:
    """The metrics of a run, and the source's time over the processor time of the run, user and system.

    Processor time hardly depends on what else the machine does. It has the reading of a log and the loop; loading and
    compiling of the hot loops is done before.
    """
    prepare(lambda _: None, config, of_log)
    began = time.process_time()
    made = go()
    seconds = time.process_time() - began
    return made.metrics, made.metrics["sim_time_s"] / seconds


def explore_figures(setting: tuple[str, ...], seed: int) -> Figures:
    """An exploration with the default configuration."""
    config = preset(scene=setting[0], task="explore", max_time=3600.0, seed=seed)
    metrics, factor = times_real_time(config, False, lambda: run(config))
    names = ("outcome", "coverage", "collisions", "home_error_m", "path_length_m", "ate_rmse_m")
    return {name: metrics[name] for name in names if name in metrics} | {"times_real_time": factor}


def relations_figures(setting: tuple[str, ...], seed: int) -> Figures:
    """`sixthsense replay LOG --relations FILE`, without another option; a log that needs one is "rejected"."""
    assert seed == 0
    name = setting[0]
    log = data_path(f"{name}/{name}.bag" if name == "clinic" else f"{name}/{name}.clf.bz2")
    relations = data_path(f"{name}/{name}.relations")
    try:
        metrics, factor = times_real_time(
            preset("log"), True, lambda: ss.replay(log, relations=relations, progress=False)
        )
    except InputError:
        return {"outcome": "rejected"}
    names = ("trans_m_mean", "trans_m_std", "trans_m_max", "rot_deg_mean", "rot_deg_std")
    figures = {name: metrics[f"relations_{name}"] for name in names}
    return figures | {"outcome": metrics["outcome"], "times_real_time": factor}


def mrclam_figures(setting: tuple[str, ...], seed: int) -> Figures:
    """MRCLAM set 6, robot 3, landmarks identified by barcodes, against Vicon."""
    assert seed == 0
    config = preset("mrclam", estimator=setting[0])
    log = read_mrclam(data_path("mrclam6"), config.assumed, mrclam.ROBOT)
    trace = replay(log, config).trace
    found = mrclam.estimator_figures(trace, true_landmarks(data_path("mrclam6")))
    names = {"per_axis_m": "position_rmse_per_axis_m", "nees": "nees3", "nis": "nis_per_dof"}
    return {"outcome": measure(trace)["outcome"]} | {name: found[key] for name, key in names.items()}


def victoria_figures(setting: tuple[str, ...], seed: int) -> Figures:
    """Victoria Park with known landmarks: `isam2` against direct calls of GTSAM, the filters against the smoother."""
    assert not setting and seed == 0
    steps, config = victoria_park.steps_of(read_graph(victoria_park.FILE)), preset("victoria").isam2
    with single_threaded():
        figures, smoothed = victoria_park.smoother_figures(steps, config)
        return figures | victoria_park.filter_figures(steps, smoothed)


def circle_figures(setting: tuple[str, ...], seed: int) -> Figures:
    """The landmark circle, 2,500 steps with known landmarks; the seed is the number of the run."""
    with single_threaded():
        track = follow(setting[0], simulate(0, seed))
    return {
        "position_rmse_m": float(np.sqrt(np.mean(track.position_m**2))),
        "heading_rmse_deg": float(np.degrees(np.sqrt(np.mean(track.heading**2)))),
        "nees": float(np.nanmean(track.nees3)),
        "nees_heading": float(np.nanmean(track.nees_heading)),
    }


def kernel_figures(setting: tuple[str, ...], seed: int) -> Figures:
    """Ratios of the compiled kernels to their references; `seed` only counts the repetitions."""
    assert not setting and seed >= 0
    with single_threaded():
        found = kernels.raycast_figures() | kernels.astar_figures(grids=2)
    return {name: found[name] for name in ("raycast_speedup_numpy", "astar_speedup_heapq")}


KINDS: dict[str, Callable[[tuple[str, ...], int], Figures]] = {
    "tour": tour_of_scene,
    "explore": explore_figures,
    "relations": relations_figures,
    "mrclam": mrclam_figures,
    "victoria": victoria_figures,
    "circle": circle_figures,
    "kernels": kernel_figures,
}


@dataclass(frozen=True, slots=True)
class Figure:
    """How a figure is judged and shown."""

    name: str
    title: str
    form: str
    best: float | Literal["low", "high", ""] = ""
    """the value that is best, or the direction; empty where it depends on the machine and is not judged"""
    scale: float = 1.0
    """factor of the value as it is shown"""


FIGURES: dict[Kind, tuple[Figure, ...]] = {
    "tour": (
        Figure("nees", "pose NEES (3)", ".2f", 3.0),
        Figure("landmark_nees", "landmark NEES (2)", ".2f", 2.0),
        Figure("nis", "NIS per dof (1)", ".3f", 1.0),
        Figure("wrong_per_1000", "wrong matches per 1,000", ".3f", "low"),
        Figure("discarded_share", "discarded, %", ".2f", "low", 100.0),
        Figure("ate_m", "ATE, mm", ".1f", "low", 1000.0),
    ),
    "explore": (
        Figure("coverage", "coverage", ".4f", "high"),
        Figure("collisions", "collisions", ".0f", "low"),
        Figure("home_error_m", "home, m", ".3f", "low"),
        Figure("path_length_m", "travel, m", ".0f", "low"),
        Figure("ate_rmse_m", "ATE, mm", ".1f", "low", 1000.0),
        Figure("times_real_time", "times real time (processor)", ".0f"),
    ),
    "relations": (
        Figure("trans_m_mean", "translation, m", ".3f", "low"),
        Figure("trans_m_std", "its spread", ".3f", "low"),
        Figure("trans_m_max", "largest, m", ".2f", "low"),
        Figure("rot_deg_mean", "rotation, °", ".2f", "low"),
        Figure("rot_deg_std", "its spread", ".2f", "low"),
        Figure("times_real_time", "times real time (processor)", ".0f"),
    ),
    "mrclam": (
        Figure("per_axis_m", "position per axis, m", ".3f", "low"),
        Figure("nees", "pose NEES (3)", ".2f", 3.0),
        Figure("nis", "NIS per dof (1)", ".3f", 1.0),
    ),
    "victoria": (
        Figure("graph_error_ratio", "graph error, `isam2` over GTSAM (1)", ".4f", "low"),
        Figure("step_ratio", "time per step, `isam2` over GTSAM", ".2f", "low"),
        Figure("ekf_rms_from_smoothed_m", "`ekf` from smoothed, m", ".1f", "low"),
        Figure("ekf_invariant_rms_from_smoothed_m", "`ekf-invariant`, m", ".1f", "low"),
    ),
    "circle": (
        Figure("position_rmse_m", "position RMSE of a run, m", ".3f", "low"),
        Figure("heading_rmse_deg", "heading RMSE, °", ".2f", "low"),
        Figure("nees", "pose NEES (3)", ".2f", 3.0),
        Figure("nees_heading", "heading NEES (1)", ".2f", 1.0),
    ),
    "kernels": (
        Figure("raycast_speedup_numpy", "ray casting over NumPy", ".1f", "high"),
        Figure("astar_speedup_heapq", "A\\* over a binary heap in Python", ".0f", "high"),
    ),
}
