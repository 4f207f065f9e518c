"""Landmarks in tours, other worlds, explorations and logs: one table of asked, measured and met; 20 minutes.

    SIXTHSENSE_DATA=FOLDER python benchmarks/evidence_landmarks.py --keep    # interrupted, the same command resumes
    python benchmarks/evidence_landmarks.py --rows tour                      # runs whose key begins so

- `tour`: the shipped scenes, for 120 s, with the filter and with the smoother.
- `family`, `plan`: tours of 80 s in generated worlds, and in plans that others drew, as of `worlds.py`.
- `explore`: plans of buildings whose walls are not straight.
- `smoother`: the apartment for 1,200 s; the mean keyframe of the last tenth over that of the second, processor time.
- `log`: `sixthsense replay LOG --front-end landmarks`, with the defaults. Errors are those of the relations.

NEES is that of the pose in world coordinates, its mean over the keyframes of each run; the error is that of the mean
over runs. A wrong match is of another wall or point than the landmark, by the walls that the returns hit
(`benchmarks/matches.py`).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from asked import Case, Found, Line, code_of, line, parsed, resumable, tabulate, within
from explored_worlds import start_of
from generated_worlds import FAMILIES
from harness import Figures, arguments, data_path, replay_errors, run, run_by_processor
from tours import tour_figures
from worlds import plan, plans_at_hand, world

from sixthsense.config import Config, preset
from sixthsense.logs.replay_input import of_log, open_recorded
from sixthsense.running.runs import QUIET, simulate

CODE = code_of(
    "asked", "evidence_landmarks", "explored_worlds", "generated_worlds", "harness", "tours", "worlds"
)  # fmt: skip
"""what the figures depend on"""

FIRST_SEED = 1000
SCENES, TOUR_SEEDS, TOUR_S = ("rectangle", "block", "apartment", "office", "loop"), 10, 120.0
FAMILY_SEEDS, PLAN_SEEDS, WORLD_S = 5, 4, 80.0
EXPLORED, EXPLORE_SEEDS = ("stata", "Freiburg101_scan", "lab_ipa_furnitures", "building_31"), 2
LONG_S = 1200.0
ESTIMATORS = ("ekf-invariant", "isam2")
LOG_M = {
    ("intel", "isam2"): 0.025, ("fr079", "isam2"): 0.05,
    ("intel", "ekf-invariant"): 0.19, ("fr079", "ekf-invariant"): 0.085,
}  # fmt: skip
"""largest mean error asked"""


def cases() -> list[Case]:
    """All runs; about the longest first, so that processes end together."""
    return [
        *(Case("explore", (name,), FIRST_SEED + k) for name in EXPLORED for k in range(EXPLORE_SEEDS)),
        *(Case("log", setting) for setting in LOG_M),
        Case("smoother", ("apartment",), FIRST_SEED),
        *(Case("plan", (name,), FIRST_SEED + k) for name in plans_at_hand() for k in range(PLAN_SEEDS)),
        *(
            Case("tour", (scene, estimator), FIRST_SEED + k)
            for estimator in reversed(ESTIMATORS)
            for scene in reversed(SCENES)
            for k in range(TOUR_SEEDS)
        ),
        *(Case("family", (name,), FIRST_SEED + k) for name in FAMILIES for k in range(FAMILY_SEEDS)),
    ]


def figures_of(case: Case) -> Figures:
    """The figures of one run."""
    name = case.setting[0]
    if case.kind == "log":
        config = preset("log", front_end="landmarks", estimator=case.setting[1])
        found = open_recorded(data_path(f"{name}/{name}.clf.bz2"), config, data_path(f"{name}/{name}.relations"))
        assert found.relations is not None
        return replay_errors(found.log, of_log(found.config, found.log), found.relations)
    estimator = case.setting[1] if case.kind == "tour" else "isam2" if case.kind == "smoother" else "ekf-invariant"
    base = preset("default", scene=name, estimator=estimator, seed=case.seed)
    if case.kind == "explore":
        return tour_figures(run(base.replaced(scene=plan(name), start=start_of(name))))
    if case.kind == "smoother":
        made = run_by_processor(base.replaced(task="tour", max_time=LONG_S))
        ms = made.trace.stopwatch.keyframe_ms()
        tenth = len(ms) // 10
        return {"last_over_second_tenth": float(ms[-tenth:].mean() / ms[tenth : 2 * tenth].mean())}
    if case.kind == "tour":
        return tour_figures(run(base.replaced(task="tour", max_time=TOUR_S)))
    return world_figures(base.replaced(task="tour", max_time=WORLD_S))


def world_figures(config: Config) -> Figures:
    """A tour of a generated world, or of a plan."""
    name = config.scene if config.scene in FAMILIES else plan(config.scene)
    scene = world(name, config.seed, WORLD_S, config.robot.speed)
    return tour_figures(simulate(config.replaced(scene=name), scene, watch=QUIET))


def lines(found: Found) -> Iterator[Line]:
    """The table."""
    for estimator in ESTIMATORS:
        runs = _runs(found, "tour", *((scene, estimator) for scene in SCENES))
        yield line(
            f"tours of {TOUR_S:.0f} s, shipped scenes, {estimator}", "NEES 2.6 to 3.4", runs, partial(_nees, 2.6, 3.4)
        )
        yield line(f"the same, {estimator}", "no wrong match", runs, _no_wrong_match)
    runs = _runs(found, "family", *((name,) for name in FAMILIES))
    yield line("tours in eight families of worlds", "NEES 2.5 to 3.6", runs, partial(_nees, 2.5, 3.6))
    plans = plans_at_hand()
    runs = _runs(found, "plan", *((name,) for name in plans))
    yield line(f"tours in {len(plans)} plans", "NEES <= 4", runs, partial(_nees, 0.0, 4.0))
    for name in EXPLORED:
        yield line(f"explored, {name}", "", _runs(found, "explore", (name,)), partial(_nees, 0.0, math.inf))
    runs = _runs(found, "explore", *((name,) for name in EXPLORED))
    yield line("explored, pooled", "NEES <= 5", runs, partial(_nees, 0.0, 5.0))
    asked = "last tenth <= 1.3 x second"
    runs = [found.get(Case("smoother", ("apartment",), FIRST_SEED).key)]
    judged = partial(within, "last_over_second_tenth", 0.0, 1.3)
    yield line(f"keyframes of isam2, apartment, {LONG_S:,.0f} s", asked, runs, judged)
    for (log, estimator), most in LOG_M.items():
        runs = [found.get(Case("log", (log, estimator)).key)]
        yield line(f"{log}, {estimator}", f"mean <= {most} m", runs, partial(within, "mean_m", 0.0, most))


def _runs(found: Found, kind: str, *settings: tuple[str, ...]) -> list[Figures | None]:
    return [found.get(case.key) for case in cases() if case.kind == kind and case.setting in settings]


def _nees(low: float, high: float, runs: Sequence[Figures]) -> tuple[str, bool]:
    shown, is_met = within("nees", low, high, runs)
    ate_mm = 1e3 * math.sqrt(np.mean([found["ate_m"] ** 2 for found in runs]))
    touched = sum(found["collisions"] for found in runs)
    return f"{shown}, ATE {ate_mm:.1f} mm" + (f", {touched} touched" if touched else ""), is_met and not touched


def _no_wrong_match(runs: Sequence[Figures]) -> tuple[str, bool]:
    wrong, count = sum(found["wrong"] for found in runs), sum(found["observations"] for found in runs)
    return f"{wrong} of {count:,}", wrong == 0


def main() -> int:
    options = parsed(arguments(__doc__), minutes=1e9)

    def work() -> int:
        if not data_path("plans").is_dir():
            raise ValueError("SIXTHSENSE_DATA: found no plans, allowed: a folder with plans and logs")
        return tabulate("landmarks", options, cases(), figures_of, lines, CODE)

    return resumable(work)


if __name__ == "__main__":
    sys.exit(main())
