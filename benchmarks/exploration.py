"""Exploration: outcome, coverage, collisions, error at home, travel and time, against random goals and a known map.

The tour of a known map is a reference, not a lower bound: viewpoints that together see the whole visible area are
chosen greedily, joined in nearest-neighbour order and improved by 2-opt. Distances are geodesic.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from harness import Figures, arguments, check_at_least, machine, pooled, print_table, run, write_json

from sixthsense.campaigns import CampaignError, load_campaign
from sixthsense.campaigns.folder import read_folder
from sixthsense.config import Config, ExploreConfig, preset
from sixthsense.core.geometry import Array
from sixthsense.evaluation.coverage import visible_area
from sixthsense.navigation.gridsearch import geodesic_distances
from sixthsense.navigation.visibility import visible_cells
from sixthsense.running.warmup import warm_up
from sixthsense.sources.scene import load_scene

COLUMNS = ("coverage", "home_error_m", "path_length_m", "sim_time_s", "realtime_factor", "ate_rmse_m")
CELL_M = 0.1
SEEN_SHARE = 0.995  # of the visible area, at the end of the tour of a known map
LATTICE = 3  # cells between candidate viewpoints


def settings(options: Any) -> list[tuple[str, Config]]:
    """Name and configuration of each setting: all combinations of the options."""
    found = []
    for scene in options.scenes:
        for estimator in options.estimators:
            for planner in options.planners:
                for method in options.methods:
                    for loop_closure in options.loop_closure:
                        config = preset(
                            options.preset, scene=scene, estimator=estimator, planner=planner, task="explore",
                            max_time=options.max_time, features={"landmarks": options.landmarks},
                            explore={
                                "method": method, "loop_closure": loop_closure == "on",
                                "loop_closure_sigma_m": options.loop_closure_sigma,
                            },
                        )  # fmt: skip
                        name = f"{scene}.{estimator}.{planner}.{method}.{options.preset}"
                        found.append((name if loop_closure == "on" else f"{name}.no_loop_closure", config))
    return found


def measure(config: Config) -> dict[str, Any]:
    """The metrics of one run."""
    return run(config).metrics


def known_map_tour(scene_name: str, config: Config) -> float:
    """Length, metres, of a round trip through viewpoints that see the whole visible area of a known map."""
    scene = load_scene(scene_name)
    assert scene.start is not None
    start = (scene.start.x, scene.start.y)
    area = visible_area(scene.walls, scene.region, start, scene.radius, config.laser.max_range, CELL_M)
    shape, origin = area.mask.shape, np.array(area.origin)
    obstacles, inflated = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
    x = origin[0] + (np.arange(shape[1]) + 0.5) * CELL_M
    y = origin[1] + (np.arange(shape[0]) + 0.5) * CELL_M
    for a, b in scene.walls:
        e = b - a
        s = ((x[None, :] - a[0]) * e[0] + (y[:, None] - a[1]) * e[1]) / max(float(e @ e), 1e-12)
        s = np.clip(s, 0.0, 1.0)
        away = np.hypot(x[None, :] - a[0] - s * e[0], y[:, None] - a[1] - s * e[1])
        obstacles |= away < 0.51 * CELL_M
        inflated |= away < scene.radius
    home = int((start[1] - origin[1]) / CELL_M), int((start[0] - origin[0]) / CELL_M)
    reachable = np.isfinite(geodesic_distances(~inflated, inflated, *home))
    rows, cols = np.nonzero(reachable)
    on = (rows % LATTICE == 0) & (cols % LATTICE == 0)
    places = np.vstack([[home], np.stack([rows[on], cols[on]], axis=1)])
    range_cells = config.laser.max_range / CELL_M
    shown = np.array([visible_cells(obstacles, area.mask, r, c, range_cells)[area.mask] for r, c in places])
    wanted = shown.any(axis=0)
    left, picked = wanted & ~shown[0], [0]
    while np.count_nonzero(left) > (1.0 - SEEN_SHARE) * np.count_nonzero(wanted):
        picked.append(int(np.argmax(shown[:, left].sum(axis=1))))
        left &= ~shown[picked[-1]]
    stops = places[picked]
    lengths = np.array([geodesic_distances(~inflated, inflated, *stop)[stops[:, 0], stops[:, 1]] for stop in stops])
    return _round_trip(lengths.astype(np.float64)) * CELL_M


def _round_trip(lengths: Array) -> float:
    """Length of a round trip through all stops: nearest neighbour first, then 2-opt to a local optimum."""
    order = [0]
    while len(order) < len(lengths):
        remaining = lengths[order[-1]].copy()
        remaining[order] = math.inf
        order.append(int(np.argmin(remaining)))
    improved = True
    while improved:
        improved = False
        for i in range(len(order) - 2):
            for j in range(i + 2, len(order)):
                a, b, c, d = order[i], order[i + 1], order[j], order[(j + 1) % len(order)]
                if lengths[a, c] + lengths[b, d] < lengths[a, b] + lengths[c, d] - 1e-9:
                    order[i + 1 : j + 1] = order[i + 1 : j + 1][::-1]
                    improved = True
    return float(sum(lengths[a, b] for a, b in zip(order, [*order[1:], order[0]], strict=True)))


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--scenes", nargs="+", default=["rectangle", "block", "apartment", "office", "loop"])
    parser.add_argument("--estimators", nargs="+", default=["ekf-invariant"])
    parser.add_argument("--planners", nargs="+", default=["astar"])
    parser.add_argument("--methods", nargs="+", default=["frontier"], choices=["frontier", "random"])
    parser.add_argument("--loop-closure", nargs="+", default=["on"], choices=["on", "off"], help="on off: the ablation")
    parser.add_argument("--loop-closure-sigma", type=float, default=0.1, metavar="M", help="threshold (0.1)")
    parser.add_argument("--landmarks", default="both", choices=["corners", "walls", "both"])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="seeds 0 to N - 1 (10)")
    parser.add_argument("--max-time", type=float, default=3600.0, metavar="S", help="simulated seconds of a run")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    parser.add_argument("--campaign", metavar="DIR", help="tabulate the runs of a campaign instead of new ones")
    parser.add_argument("--tour", action="store_true", help="also compute the tour of the known map")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1, jobs=1)
    if options.campaign is not None:
        try:
            runs = campaign_runs(options.campaign)
        except CampaignError as error:
            parser.error(f"--campaign: {error}")
    else:
        warm_up()
        kinds = settings(options)
        configs = [dataclasses.replace(config, seed=seed) for _, config in kinds for seed in range(options.seeds)]
        results = list(pooled(measure, configs, options.jobs, warm_up))
        runs = {name: results[k * options.seeds : (k + 1) * options.seeds] for k, (name, _) in enumerate(kinds)}
    figures, rows = summary(runs)
    figures |= ratios(figures, options)
    print(machine())
    print_table(rows)
    for key, value in figures.items():
        if ".over_" in key or key.endswith("known_map_tour_m"):
            print(f"{key}  {value:.3g}")
    write_json(options.json, figures)


def campaign_runs(folder: str) -> dict[str, list[dict[str, Any]]]:
    """The metrics of a campaign's runs by scene, estimator, planner, method and preset, without missing values."""
    runs: dict[str, list[dict[str, Any]]] = {}
    method = read_folder(Path(folder))["fields"].get("explore", {}).get("method", ExploreConfig().method)
    for row in load_campaign(folder).frame().to_dict("records"):
        name = f"{row['scene']}.{row['estimator']}.{row['planner']}.{method}.{row['preset']}"
        runs.setdefault(name, []).append({key: value for key, value in row.items() if value == value})
    return runs


def summary(runs: dict[str, list[dict[str, Any]]]) -> tuple[Figures, list[list[str]]]:
    """Figures over the runs of each setting, and a table with a row for each."""
    figures: Figures = {}
    rows = [[
        "setting", "runs", "outcomes", "collisions", "coverage, min", "home m, max", "travel m", "sim s", "x real",
        "ATE m",
    ]]  # fmt: skip
    reduce: dict[str, Any] = {"coverage": np.min, "home_error_m": np.max}
    for name, mine in runs.items():
        outcomes = Counter(result["outcome"] for result in mine)
        figures |= {f"{name}.outcome.{o.replace(' ', '_')}": n for o, n in outcomes.items()}
        figures[f"{name}.collisions"] = sum(result.get("collisions", 0) for result in mine)
        for key in COLUMNS:
            values = [result[key] for result in mine if key in result]
            if values:
                figures[f"{name}.{key}"] = float(reduce.get(key, np.median)(values))
        counts = ", ".join(f"{n} {o}" for o, n in outcomes.most_common())
        cells = [figures.get(f"{name}.{key}") for key in COLUMNS]
        shown = ["" if value is None else f"{value:.4g}" for value in cells]
        rows.append([name, str(len(mine)), counts, f"{figures[f'{name}.collisions']:.0f}", *shown])
    return figures, rows


def ratios(figures: Figures, options: Any) -> Figures:
    """Ratios of the path length by frontiers to that by random goals and to the tour of the known map."""
    found: Figures = {}
    tours = {s: known_map_tour(s, preset(options.preset)) for s in options.scenes} if options.tour else {}
    for scene, length in tours.items():
        found[f"{scene}.known_map_tour_m"] = length
    for key, travel in list(figures.items()):
        if not key.endswith(".path_length_m") or ".frontier." not in key:
            continue
        name = key.removesuffix(".path_length_m")
        random = figures.get(key.replace(".frontier.", ".random."))
        if random:
            found[f"{name}.over_random"] = travel / random
        if tours.get(key.split(".")[0]):
            found[f"{name}.over_known_map_tour"] = travel / tours[key.split(".")[0]]
    return found


if __name__ == "__main__":
    main()
