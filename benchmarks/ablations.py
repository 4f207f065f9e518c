"""Ablations: the goal task with one part of the pipeline switched off or on at a time, over seeds.

A true landmark is an end, a corner or a crossing of walls. It is visible in a scan if it lies within the laser's field
of view and within 3 m, where beams one degree apart are 5 cm apart, and if the ray from the laser's true pose to it is
free. An observation is false if it lies farther than 0.15 m from every true landmark, visible or not. A visible
landmark is missed if no observation lies within 0.15 m of it. Both are counted on the scans of the baseline's runs, one
scan per second, placed at their true poses, so that every switch of the extraction is measured on the same scans.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from harness import Figures, arguments, check_at_least, machine, print_table, run, write_json

from sixthsense.config import Config, LaserConfig, merge, preset
from sixthsense.core.geometry import Array, Pose, point_segment_distance, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Tick
from sixthsense.evaluation.metrics import ate, true_landmarks
from sixthsense.record.trace import Trace
from sixthsense.running.warmup import warm_up
from sixthsense.slam.features import extract
from sixthsense.sources.scene import load_scene

GATE_M, NEAR_M = 0.15, 3.0
_SIGHT_M = 0.02  # a ray that ends this close to a landmark has reached it
_EVERY_S = 1.0  # between two counted scans

BASELINE = "baseline"
PRESETS = ("default", "report")
MAX_TIME = {"default": 300.0, "report": 900.0}  # simulated seconds

SWITCHES: dict[str, dict[str, Any]] = {
    BASELINE: {},
    "iep_off": {"features": {"split": {"enabled": False}}},
    "least_squares_off": {"features": {"lines": {"least_squares": False}}},
    "culling_off": {"association": {"culling": False}},
    "shortcut_off": {"follow": {"shortcut": False}},
}
_EXTRACTION = (BASELINE, "iep_off", "least_squares_off")

# Column name and key of the figure.
COLUMNS = (
    ("false / scan", "false_per_scan"),
    ("missed / scan", "missed_per_scan"),
    ("error mm", "observation_rmse_mm"),
    ("walls' mm", "wall_rmse_mm"),
    ("ATE m, median", "ate_rmse_m_median"),
    ("max", "ate_rmse_m_max"),
    ("landmarks", "landmarks_median"),
    ("culled", "landmarks_culled_median"),
    ("not real, mean", "landmarks_false_mean"),
    ("time s", "sim_time_s_median"),
    ("path m", "path_length_m_median"),
    ("turned rad", "turned_rad_median"),
)


@dataclass(frozen=True, slots=True)
class View:
    """A scan and the landmarks visible in it."""

    scan: Scan
    truth: Pose
    """of the robot"""
    visible: Array
    """(V, 2) true landmarks, world frame"""


def visible_landmarks(pose: Pose, landmarks: Array, walls: Array, laser: LaserConfig) -> Array:
    """The `landmarks` (M, 2) visible to the laser of a robot at the true `pose`: (V, 2), metres, world frame."""
    T_world_laser = pose @ Pose(*laser.mount)
    seen = T_world_laser.inverse() @ landmarks
    bearings, ranges = np.arctan2(seen[:, 1], seen[:, 0]), np.hypot(seen[:, 0], seen[:, 1])
    free = cast_rays(T_world_laser, bearings, walls, 2.0 * NEAR_M)
    inside = (np.abs(bearings) <= 0.5 * laser.fov) & (ranges < NEAR_M)
    return np.asarray(landmarks[inside & (free > ranges - _SIGHT_M)])


def collect(config: Config) -> tuple[Trace, list[View]]:
    """Run once and keep one view per second."""
    scene = load_scene(config.scene)
    landmarks = true_landmarks(scene.walls)
    views: list[View] = []
    due_ns = 0

    def keep(tick: Tick, trace: Trace) -> None:
        nonlocal due_ns
        if tick.scan is not None and tick.truth is not None and tick.stamp_ns >= due_ns:
            due_ns = tick.stamp_ns + round(_EVERY_S * 1e9)
            visible = visible_landmarks(tick.truth, landmarks, scene.walls, config.laser)
            views.append(View(tick.scan, tick.truth, visible))

    return run(config, keep).trace, views


def detection_figures(views: Sequence[View], walls: Array, config: Config) -> Figures:
    """False and missed landmarks per scan, and the RMS error, mm, of the other landmarks and of wall ends."""
    landmarks = true_landmarks(walls)
    rng = np.random.default_rng(0)
    false = missed = 0
    squared: list[float] = []
    off_walls: list[float] = []
    for view in views:
        features = extract(view.scan, config.assumed, config.features, rng)
        points = view.truth @ np.array([s.z for s in features.observations]).reshape(-1, 2)
        ends = view.truth @ features.walls.reshape(-1, 2)
        off_walls += [float(point_segment_distance(end, walls).min()) for end in ends]
        nearest = _distances(points, landmarks).min(axis=1, initial=math.inf)
        false += int(np.sum(nearest > GATE_M))
        squared += (nearest[nearest <= GATE_M] ** 2).tolist()
        missed += int(np.sum(_distances(view.visible, points).min(axis=1, initial=math.inf) > GATE_M))
    return {
        "false_per_scan": false / len(views),
        "missed_per_scan": missed / len(views),
        "visible_per_scan": sum(len(view.visible) for view in views) / len(views),
        "observation_rmse_mm": 1e3 * math.sqrt(sum(squared) / len(squared)) if squared else 0.0,
        "wall_rmse_mm": 1e3 * math.sqrt(float(np.mean(np.square(off_walls)))) if off_walls else 0.0,
    }


def run_figures(trace: Trace, landmarks: Array) -> dict[str, float]:
    """Figures of one run."""
    truth = np.array(trace.truths)
    gaps = _distances(trace.final.landmarks, landmarks).min(axis=1, initial=math.inf)
    return {
        "ate_rmse_m": ate(np.array(trace.estimates), truth)[0],
        "landmarks": len(trace.records),
        "landmarks_culled": trace.culled,
        "landmarks_false": int(np.sum(gaps > GATE_M)),
        "sim_time_s": 1e-9 * (trace.stamps_ns[-1] - trace.stamps_ns[0]),
        "path_length_m": trace.path_length_m,
        "turned_rad": float(np.abs(wrap_angle(np.diff(truth[:, 2]))).sum()),
        "keyframe_ms": sum(sum(row.values()) - row.get("sense", 0.0) for row in trace.stopwatch.rows)
        / max(len(trace.stopwatch.rows), 1),
    }


def ablation_figures(name: str, seeds: int, scene: str = "apartment", max_time: float | None = None) -> Figures:
    """Figures of all switches for one preset, with keys `preset.switch.figure`.

    Times and lengths are those of runs that reached the goal.
    """
    report = {"task": "goal", "features": {"landmarks": "corners"}}
    base = preset(name, scene=scene, max_time=max_time or MAX_TIME[name], **report)
    walls = load_scene(scene).walls
    landmarks = true_landmarks(walls)
    views: list[View] = []
    figures: Figures = {}
    for switch, changes in SWITCHES.items():
        config = merge(base, changes)
        rows, outcomes = [], Counter[str]()
        for seed in range(seeds):
            seeded = dataclasses.replace(config, seed=seed)
            if switch == BASELINE:
                trace, seen = collect(seeded)
                views += seen
            else:
                trace = run(seeded).trace
            rows.append(run_figures(trace, landmarks) | {"done": float(trace.outcome == "goal reached")})
            outcomes[trace.outcome.replace(" ", "_")] += 1
        found: Figures = {f"outcome.{outcome}": count for outcome, count in outcomes.most_common()}
        if switch in _EXTRACTION:
            found |= detection_figures(views, walls, config)
        done = [row for row in rows if row["done"]] or rows
        for key in rows[0]:
            is_travel = key in ("sim_time_s", "path_length_m", "turned_rad")
            found[f"{key}_median"] = float(np.median([row[key] for row in (done if is_travel else rows)]))
        found["landmarks_false_mean"] = float(np.mean([row["landmarks_false"] for row in rows]))
        found["goals_reached"] = sum(row["done"] for row in rows)
        found["ate_rmse_m_max"] = max(row["ate_rmse_m"] for row in rows)
        del found["done_median"]
        figures |= {f"{name}.{switch}.{key}": value for key, value in found.items()}
    return figures


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement of the report and the condition on the figures under which it holds."""

    switch: str
    text: str
    worse: Callable[[Mapping[str, float], Mapping[str, float]], bool]
    """whether the statement holds, given the figures without the part and with it"""
    shown: tuple[str, ...]


def _errs_more(off: Mapping[str, float], on: Mapping[str, float]) -> bool:
    def wrong(figures: Mapping[str, float]) -> float:
        return figures["false_per_scan"] + figures["missed_per_scan"]

    return wrong(off) > 1.1 * wrong(on)


CLAIMS = (
    Claim(
        "iep_off",
        "iterative end points make detection much more robust",
        _errs_more,
        ("false_per_scan", "missed_per_scan", "wall_rmse_mm", "ate_rmse_m_median", "goals_reached"),
    ),
    Claim(
        "least_squares_off",
        "least squares makes detection more stable",
        lambda off, on: off["wall_rmse_mm"] > 1.1 * on["wall_rmse_mm"],
        ("wall_rmse_mm", "observation_rmse_mm", "ate_rmse_m_median"),
    ),
    Claim(
        "culling_off",
        "culling removes bad landmarks",
        lambda off, on: off["landmarks_false_mean"] > on["landmarks_false_mean"],
        ("landmarks_false_mean", "landmarks_median", "ate_rmse_m_median"),
    ),
    Claim(
        "shortcut_off",
        "the shortcut saves much time",
        lambda off, on: off["sim_time_s_median"] > 1.1 * on["sim_time_s_median"],
        ("sim_time_s_median", "path_length_m_median", "turned_rad_median"),
    ),
)


def sentence(name: str, claim: Claim, figures: Figures) -> str:
    """Whether a claim holds for a preset, with the figures it depends on."""
    ours, base = _of(figures, f"{name}.{claim.switch}."), _of(figures, f"{name}.{BASELINE}.")
    verdict = "holds" if claim.worse(ours, base) else "does not hold here"
    changes = ", ".join(f"{key} {base[key]:.3g} -> {ours[key]:.3g}" for key in claim.shown)
    return f"{name}: {claim.text}: {verdict} ({claim.switch.replace('_', ' ')}: {changes})."


def _of(figures: Figures, prefix: str) -> Figures:
    return {key.removeprefix(prefix): value for key, value in figures.items() if key.startswith(prefix)}


def row(name: str, switch: str, figures: Figures) -> list[str]:
    """A row of the table."""
    own = _of(figures, f"{name}.{switch}.")
    outcomes = [f"{int(n)} {k.removeprefix('outcome.')}" for k, n in own.items() if k.startswith("outcome.")]
    cells = [f"{own[key]:.3g}" if key in own else "" for _, key in COLUMNS]
    return [f"{name}.{switch}", ", ".join(outcomes).replace("_", " "), *cells]


def _distances(points: Array, others: Array) -> Array:
    """(N, M) metres between two sets of points."""
    gaps = points[:, None, :] - others[None, :, :]
    return np.asarray(np.hypot(gaps[..., 0], gaps[..., 1]))


def main() -> None:
    parser = arguments((__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="seeds per preset and switch (20)")
    options = parser.parse_args()
    check_at_least(parser, options, seeds=1)
    warm_up()
    figures: Figures = {}
    for name in PRESETS:
        figures |= ablation_figures(name, options.seeds)
    print(machine())
    head = ["preset and switch", "outcomes", *(column[0] for column in COLUMNS)]
    print_table([head, *(row(name, switch, figures) for name in PRESETS for switch in SWITCHES)])
    for claim in CLAIMS:
        for name in PRESETS:
            print(sentence(name, claim, figures))
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
