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
(`sixthsense.evaluation.matches`).
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from asked import Case, Figures, Found, Line, line, measure, selected, warm, within
from explored_worlds import places_at_hand
from generated_worlds import FAMILIES
from harness import (
    PACKAGE,
    arguments,
    check_at_least,
    code_commit,
    data_path,
    finish,
    print_table,
    replay_errors,
    run,
    run_by_processor,
)
from tours import Row, judge, make_row, nees_of, tour
from worlds import make_row as make_world_row
from worlds import maps_at_hand

from sixthsense.config import preset
from sixthsense.sources.replay_input import of_log, open_recorded

CODE = (*PACKAGE, *(f"benchmarks/{name}.py" for name in (
    "asked", "evidence_landmarks", "explored_worlds", "generated_worlds", "harness", "tours", "worlds")))  # fmt: skip
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
    plans = [name for name in maps_at_hand() if name.endswith(".yaml")]
    return [
        *(Case("explore", (name,), FIRST_SEED + k) for name in EXPLORED for k in range(EXPLORE_SEEDS)),
        *(Case("log", setting) for setting in LOG_M),
        Case("smoother", ("apartment",), FIRST_SEED),
        *(Case("plan", (Path(name).stem,), FIRST_SEED + k) for name in plans for k in range(PLAN_SEEDS)),
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
    if case.kind == "tour":
        return _figures(make_row(dataclasses.replace(tour(name, case.setting[1], "default", TOUR_S), seed=case.seed)))
    base = preset("default", estimator="ekf-invariant", seed=case.seed)
    if case.kind in ("family", "plan"):
        scene = name if case.kind == "family" else str(data_path(f"plans/{name}.yaml"))
        return _figures(make_world_row(dataclasses.replace(base, scene=scene, task="tour", max_time=WORLD_S)))
    if case.kind == "explore":
        (place,) = (place for place in places_at_hand() if Path(place.scene).stem == name)
        return _figures(judge(run(dataclasses.replace(base, scene=place.scene, start=place.start)).trace))
    if case.kind == "smoother":
        made = run_by_processor(dataclasses.replace(base, scene=name, estimator="isam2", task="tour", max_time=LONG_S))
        ms = made.trace.stopwatch.keyframe_ms()
        tenth = len(ms) // 10
        return {"last_over_second_tenth": float(ms[-tenth:].mean() / ms[tenth : 2 * tenth].mean())}
    found = open_recorded(
        data_path(f"{name}/{name}.clf.bz2"),
        preset("log", front_end="landmarks", estimator=case.setting[1]),
        data_path(f"{name}/{name}.relations"),
    )
    assert found.relations is not None
    return replay_errors(found.log, of_log(found.config, found.log), found.relations)


def _figures(row: Row) -> Figures:
    figures = {name: row[name] for name in ("outcome", "collisions", "wrong", "observations", "ate_rmse_m")}
    return figures | {"nees": nees_of(row)}


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
    plans = [Path(name).stem for name in maps_at_hand() if name.endswith(".yaml")]
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
    ate_mm = 1e3 * math.sqrt(np.mean([found["ate_rmse_m"] ** 2 for found in runs]))
    touched = sum(found["collisions"] for found in runs)
    return f"{shown}, ATE {ate_mm:.1f} mm" + (f", {touched} touched" if touched else ""), is_met and not touched


def _no_wrong_match(runs: Sequence[Figures]) -> tuple[str, bool]:
    wrong, count = sum(found["wrong"] for found in runs), sum(found["observations"] for found in runs)
    return f"{wrong} of {count:,}", wrong == 0


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--rows", nargs="+", default=[], metavar="KEY", help="runs whose key begins so (all)")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="processes (2)")
    parser.add_argument("--minutes", type=float, default=1e9, metavar="M", help="begin no run after so many (no limit)")
    options = parser.parse_args()
    check_at_least(parser, options, jobs=1, minutes=0.0)
    try:
        if not data_path("plans").is_dir():
            raise ValueError("SIXTHSENSE_DATA: found no plans, allowed: a folder with plans and logs")
        chosen = selected(cases(), options.rows)
        found = measure(chosen, figures_of, options, code_commit(CODE), warm)
    except (ValueError, RuntimeError) as error:
        print(f"evidence_landmarks.py: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("evidence_landmarks.py: interrupted; the same command resumes", file=sys.stderr)
        return 130
    if left := len(chosen) - len(found):
        print(f"{left} runs are left; the same command goes on", file=sys.stderr)
    table = [Line._fields, *(each for each in lines(found) if each.measured)]
    if options.keep and (left or options.rows):
        print("evidence_landmarks.py: nothing is kept of a part", file=sys.stderr)
        print_table(table)
        return 2
    finish(options, "landmarks", table, text=4)
    return 0


if __name__ == "__main__":
    sys.exit(main())
