"""What is measured: kinds of cases with their settings, seeds, figures, and what is asked of them.

Simulated runs begin at seed 1,000, which no parameter was chosen on. The replay of a log is as the plain command makes
it; nothing in it is random.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import audits
import explored
import interruptions
import landmark_runs
import live_network
import log_runs
import repetition
import verdict
import victoria_park
from damaged_logs import DAMAGES
from generated_worlds import FAMILIES
from repetition_scenes import SCENES
from runs import Figures, Setting, data_path
from wrong_logs import WRONG

from sixthsense.slam.estimators import ESTIMATORS

PLANS = (
    "Freiburg101_scan", "Freiburg79_scan", "building_31", "kth_50037765_PLAN3", "kth_50052750", "kth_50052752",
    "lab_ipa", "lab_ipa_furnitures", "office_a", "stata", "willow",
)  # fmt: skip
"""under SIXTHSENSE_DATA, of buildings that others drew"""
LOGS = tuple(log_runs.FILES)


class Column(NamedTuple):
    """A figure over the runs of a row, and what is asked of it."""

    title: str
    figure: str
    """`name` for the mean, `name sum`, `name max`, or `one / other` for the quotient of sums"""
    form: str
    asked: str = ""
    """`<= 0.5`, `>= 0.9`, `2.4 to 3.9`; empty where it is not judged"""
    scale: float = 1.0
    """factor of the value as it is shown; what is asked is of the value itself"""


class Kind(NamedTuple):
    """Measurements that have one table."""

    run: Callable[[Setting, int], Figures]
    heads: tuple[str, ...]
    """column names of the setting"""
    cases: Sequence[Setting]
    columns: tuple[Column, ...]
    count: int = 1
    """of seeds"""
    first: int = 0
    """seed"""
    checked: int = 0
    """how many seeds `--check` repeats; 0 for none"""
    pooled: bool = False
    """whether the table has a line of all runs"""
    alone: bool = False
    """whether nothing else may run meanwhile"""
    needs: str = ""
    """a file under SIXTHSENSE_DATA; `{0}` is the setting's first word"""

    @property
    def seeds(self) -> Sequence[int]:
        """The seeds of the runs of each case."""
        return range(self.first, self.first + self.count)

    def missing(self, setting: Setting) -> str:
        """The data that a case needs and that are not there; empty if nothing is missing."""
        file = self.needs.format(*setting)
        return f"{file} under SIXTHSENSE_DATA" if file and not data_path(file).exists() else ""


def of(names: Sequence[str]) -> list[Setting]:
    """Settings of one word."""
    return [(name,) for name in names]


NEES = Column("pose NEES (3)", "nees", ".2f", "2.4 to 3.9")
OFF = (
    Column("mean, m", "trans_m_mean", ".4f"),
    Column("its spread", "trans_m_std", ".4f"),
    Column("largest, m", "trans_m_max", ".2f"),
    Column("rotation, °", "rot_deg_mean", ".2f"),
    Column("beyond 0.5 m, %", "beyond_share", ".2f", "", 100.0),
)
TIMES = Column("times real time (processor)", "times_real_time", ".0f")
TOUCHES = Column("touches", "collisions sum", ".0f", "<= 0")
ATE_MM = Column("ATE, mm", "ate_m", ".1f", "", 1e3)
TOUR = (
    NEES,
    Column("landmark NEES (2)", "landmark_nees", ".2f"),
    Column("NIS per dof (1)", "nis", ".3f"),
    Column("wrong matches", "wrong sum", ".0f"),
    Column("discarded, %", "discarded_share", ".2f", "", 100.0),
    ATE_MM,
)
EXPLORED = (Column("coverage", "coverage min", ".4f", ">= 0.997"), TOUCHES)
DRIVEN = (
    Column("travel over nearest frontier", "compared_m / reference_m", ".2f", "<= 1.03"),
    Column("worst", "ratio max", ".2f", "<= 1.6"),
    Column("navigation p99, ms", "plan_ms_p99 max", ".0f"),
)


def speeds(setting: Setting, seed: int) -> Figures:
    """Milliseconds of the hot loops and of their peers, by `test_speed.py`, and what one is over the other."""
    with tempfile.TemporaryDirectory() as folder:
        file, tests = Path(folder) / "speed.json", Path(__file__).with_name("test_speed.py")
        words = ["-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", tests, f"--benchmark-json={file}"]
        subprocess.run([sys.executable, *map(str, words)], check=True, stdout=subprocess.DEVNULL)
        found = json.loads(file.read_text())["benchmarks"]
    ms = {one["name"].removeprefix("test_"): 1e3 * one["stats"]["median"] for one in found}
    return ms | {
        "raycast_over_peer": ms["raycast[peer]"] / ms["raycast[ours]"],
        "astar_over_peer": ms["astar[peer]"] / ms["astar[ours]"],
        "update_passes": ms["update[1000]"] / ms["pass"],
        "scan_ms": ms["extraction"] / 200, "insertion_ms": ms["map_insertion"] / 200,
    }  # fmt: skip


# About the longest first of those that go together, so that processes end at about the same time.
KINDS: dict[str, Kind] = {
    "relations": Kind(
        log_runs.relations, ("log",), of(LOGS),
        (Column("mean, m", "trans_m_mean", ".4f", "<= 0.11"), *OFF[1:], TIMES), needs="{0}", checked=1,
    ),
    "damaged": Kind(
        log_runs.damage, ("log", "damage"),
        [*itertools.product(("intel", "fr079", "aces"), DAMAGES)],
        (
            Column("mean, m", "trans_m_mean max", ".4f", "<= 0.12"),
            Column("largest, m", "trans_m_max max", ".2f", "<= 0.5"),
        ),
        count=2, first=1, needs="{0}",
    ),
    "repetition": Kind(
        repetition.drive_figures, ("drive",), of(tuple(SCENES)),
        (
            Column("false loop closures", "false sum", ".0f", "<= 0"),
            Column("closed, %", "closed / true", ".1f", ">= 0.8", 100.0),
            Column("ATE, m", "ate_m median", ".3f"),
        ),
        count=2, first=1000,
    ),
    "scans": Kind(
        log_runs.relations, ("log", "motion by"),
        [(log, "scans alone") for log in ("fr079", "intel", "aces")], OFF[::2], needs="{0}",
    ),
    "covariances": Kind(
        log_runs.stated_covariances, ("log",), of(LOGS),
        (
            Column("relations", "relations", ".0f"),
            *(Column(f"within {100 * share:.0f} %", f"within_{100 * share:.0f}", ".1f", "", 100.0)
              for share in log_runs.SHARES),
            Column("d² / 3", "squared", ".2f"),
            Column("stated, mm", "stated_m", ".1f", "", 1e3),
        ),
        needs="{0}",
    ),
    "lost": Kind(
        log_runs.lost, ("lost in the map of",), of(("apartment", "office")),
        (Column("error at the end, m", "error_m max", ".3f", "<= 0.2"),), count=5, first=1000,
    ),
    "merged": Kind(
        log_runs.merged, ("two runs of",), of(("apartment", "office")), (ATE_MM,), count=5, first=1000,
    ),
    "tour": Kind(
        landmark_runs.tour, ("tour of 200 s", "estimator"),
        [*itertools.product(("apartment", "office"), ("ekf", "ekf-invariant", "isam2"))],
        TOUR, count=10, first=1000, checked=4,
    ),
    "world": Kind(
        landmark_runs.tour_of_world, ("tour of 80 s", "name"),
        [*(("family", name) for name in FAMILIES), *(("plan", name) for name in PLANS)],
        (NEES, *TOUR[1:3], ATE_MM), count=5, first=1000, pooled=True, needs="plans",
    ),
    "circle": Kind(
        landmark_runs.circle, ("landmark circle",), of(tuple(ESTIMATORS)),
        (
            Column("position RMSE of a run, m", "position_rmse_m", ".3f"),
            Column("heading RMSE, °", "heading_rmse_deg", ".2f"),
            Column("pose NEES (3)", "nees", ".2f"),
            Column("heading NEES (1)", "nees_heading", ".2f"),
        ),
        count=40,
    ),
    "mrclam": Kind(
        landmark_runs.mrclam, ("robot",), of(tuple("12345")),
        (
            Column("per axis, m", "per_axis_m", ".3f"), Column("aligned, m", "aligned_m", ".3f"),
            Column("map turned, °", "map_turn_deg", ".1f"), Column("heading, °", "heading_deg", ".2f"),
            Column("NEES (3)", "nees", ".2f"), Column("NIS per dof", "nis", ".3f"),
            Column("misread", "misread", ".0f"),
        ),
        needs="mrclam6",
    ),
    "victoria": Kind(
        victoria_park.figures, (), [()],
        (
            Column("graph error, `isam2` over GTSAM (1)", "graph_error_ratio", ".4f", "<= 1.001"),
            Column("time per step, `isam2` over GTSAM", "step_ratio", ".2f"),
            Column("`ekf` from smoothed, m", "ekf_rms_from_smoothed_m", ".1f"),
            Column("`ekf-invariant`, m", "ekf_invariant_rms_from_smoothed_m", ".1f"),
        ),
        checked=1,
    ),
    "explore": Kind(
        explored.shipped, ("exploration",), of(explored.SHIPPED),
        (
            *EXPLORED, Column("home, m", "home_m", ".3f"), Column("travel, m", "travel_m", ".0f"), ATE_MM, TIMES,
        ),
        count=5, first=1000, checked=2,
    ),
    "large": Kind(
        explored.large, ("large building",), of(tuple(explored.LARGE)),
        (*EXPLORED, *DRIVEN, NEES, TIMES), first=1000, needs="plans",
    ),
    "houses": Kind(
        explored.house, (), [()], (*EXPLORED, *DRIVEN, Column("NEES", "nees", ".2f", "2.4 to 3.6")),
        count=42, first=explored.HOUSE_SEED, needs="houses",
    ),
    "odd": Kind(
        explored.odd, (), [()], (Column("ended", "ended sum", ".0f", ">= 38"), TOUCHES), count=40, first=1000,
    ),
    "door": Kind(
        explored.door, ("door wider than the robot, m",), of(("0.05", "0.08", "0.1", "0.13", "0.17")),
        (
            Column("passed", "passed sum", ".0f"), TOUCHES, Column("home, m", "home_m max", ".2f", "<= 0.2"),
            Column("coverage", "coverage min", ".4f"),
        ),
        count=len(explored.DOORS),
    ),
    "people": Kind(
        explored.people, ("scene", "estimator", "walkers"),
        [*itertools.product(("apartment", "office"), explored.FRONT_ENDS, ("0", "3", "10"))],
        (
            Column("coverage", "coverage min", ".4f", ">= 0.995"),
            Column("robot's fault", "by_robot sum", ".0f", "<= 0"), Column("walkers'", "by_walkers sum", ".0f"),
            Column("NEES", "nees", ".2f", "2 to 4"), Column("simulated s", "sim_s", ".0f"),
            Column("stray, %", "stray_share", ".3f", "<= 0.001", 100.0),
            ATE_MM,
        ),
        count=5,
    ),
    "audit": Kind(
        audits.audit, ("errors", "space", "stated covariance"),
        [*itertools.product(audits.RHO, ("SE(2)", "SE(3)"), audits.EXPECTED)],
        (
            Column("right verdicts, %", "right", ".0f", ">= 0.9", 100.0),
            Column("interval holds the factor, %", "held", ".0f", "", 100.0), Column("mean factor", "factor", ".2f"),
            Column("ends of the interval, ratio", "width median", ".2f"),
            Column("effective samples", "samples median", ",.0f"), Column("in theory", "in_theory median", ",.0f"),
        ),
        count=100,
    ),
    "verdict": Kind(
        verdict.judged, ("damage",), of(("clean", *WRONG, *(name for name in DAMAGES if name != "clean"))),
        (
            Column("wrong", "wrong sum", ".0f"), Column("of these told", "told sum", ".0f"),
            Column("others", "right sum", ".0f"), Column("of these told good", "good sum", ".0f"),
            Column("told, %", "told / wrong", ".0f", ">= 0.75", 100.0),
            Column("told good, %", "good / right", ".0f", ">= 0.92", 100.0),
        ),
        pooled=True, needs="aces",
    ),
    "reliability": Kind(
        verdict.reliability, (), [()],
        tuple(
            Column(f"off, told {low:g} to {high:g}, %", f"share_{k}", ".1f", "", 100.0)
            for k, (low, high) in enumerate(itertools.pairwise(verdict.BINS))
        ),
        needs="aces", alone=True,
    ),
    "interruptions": Kind(
        interruptions.interrupted, (), [()],
        (Column("stopped", "stopped sum", ".0f"), Column("lost", "lost sum", ".0f", "<= 0")), count=10, alone=True,
    ),
    "found": Kind(
        live_network.found, ("seconds until both have found each other",), of(tuple(live_network.CONNECTIONS)),
        tuple(
            Column(name.replace("_", " "), name, ".1f")
            for name in ("live_first", "robot_again", "live_again", "robot_first")
        ),
        alone=True,
    ),
    "speed": Kind(
        speeds, (), [()],
        (
            Column("ray casting over NumPy", "raycast_over_peer", ".1f", ">= 12"),
            Column("A\\* over a heap in Python", "astar_over_peer", ".1f", ">= 20"),
            Column("extraction of a scan, ms", "scan_ms", ".2f", "<= 0.2"),
            Column("insertion of a scan, ms", "insertion_ms", ".2f"),
            Column("update with 30 landmarks, ms", "update[30]", ".3f", "<= 0.06"),
            Column("update with 1,000, passes over the covariance", "update_passes", ".1f", "<= 1.3"),
        ),
        alone=True, checked=1,
    ),
}  # fmt: skip
