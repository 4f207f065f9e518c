"""Counterparts of the report's figures, from new runs; docs/report.md names what they show."""

from __future__ import annotations

import argparse
import functools
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.cli import main as sixthsense
from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.evaluation.metrics import true_landmarks
from sixthsense.figures import legend, new_axes, plot
from sixthsense.figures.plot import ESTIMATE, LANDMARK, OBSERVATION, PLAN, WALL
from sixthsense.navigation.planners.shortcut import shortcut
from sixthsense.running.warmup import warm_up
from sixthsense.slam.features import Features

sys.path.insert(0, str(Path(__file__).parents[2] / "notebooks"))

import drawing
from drawing import Recording, draw_truth, features_of, record, strays_m, window

SCAN = 48  # a keyframe of the apartment that sees corridor, living room, bath and kitchen
CORNERS = {"landmarks": "corners"}
WITHOUT_IEP = preset("default", estimator="ekf", task="goal", features={**CORNERS, "split": {"epsilon_m": 100.0}})
# Three times the laser noise produces bad landmarks.
ROUGH: dict[str, Any] = {
    "estimator": "ekf",
    "world": {"laser": {"range_m": 0.03}},
    "assumed": {"laser": {"range_m": 0.03}},
    "features": CORNERS,
    "task": "tour",
    "max_time": 80.0,
    "seed": 4,
}


@functools.cache
def apartment() -> Recording:
    """The run shown in most figures."""
    return record(preset("default", estimator="ekf", task="goal", features=CORNERS))


def calibration(file: Path) -> None:
    """Figure 1: errors of landmarks with their fitted covariance, as `sixthsense calibrate` draws them."""
    with tempfile.TemporaryDirectory() as folder:
        noise = Path(folder) / "noise.toml"
        if sixthsense(["calibrate", "apartment", "--out", str(noise)]) != 0:
            raise SystemExit("calibration failed")
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(noise.with_suffix(".png"), file)


def pipeline() -> Any:
    """Figure 2: the stages from a scan to landmarks."""
    run = apartment()
    pose, scan, features = run.pose(SCAN), run.scans[SCAN], run.features(SCAN)
    figure, axes = new_axes(2, 3, 12.0, 9.2)
    titles = "scan", "returns", "discontinuity: first level", "IEP: second level", "least squares", "landmarks"
    for ax, title in zip(axes, titles, strict=True):
        draw_truth(ax, run.scene, near=pose.position, reach_m=5.0)
        drawing.draw_robot(ax, pose, run.trace.radius_m)
        ax.set_title(title)
        ax.label_outer()
    drawing.draw_beams(axes[0], pose, scan)
    drawing.draw_returns(axes[1], pose, scan)
    drawing.draw_partitions(axes[2], pose, scan, features.pieces)
    drawing.draw_partitions(axes[3], pose, scan, features.spans, least=run.trace.config.features.lines.min_points)
    bare = Features(features.walls, (), features.pieces, features.spans)
    drawing.draw_detections(axes[4], pose, bare)
    drawing.draw_detections(axes[5], pose, features)
    legend(figure)
    return figure


def partitions() -> Any:
    """Figure 3: partitions by discontinuity and by iterative end points."""
    run = apartment()
    pose, scan, features = run.pose(SCAN), run.scans[SCAN], run.features(SCAN)
    figure, axes = new_axes(1, 2, 12.0, 6.2)
    least = run.trace.config.features.lines.min_points
    for ax, parts, by in zip(axes, (features.pieces, features.spans), ("discontinuity", "IEP"), strict=True):
        draw_truth(ax, run.scene, "#E4E4E4", pose.position, 5.0)
        drawing.draw_partitions(ax, pose, scan, parts, least)
        drawing.draw_robot(ax, pose, run.trace.radius_m)
        ax.set_title(f"{sum(len(part) >= least for part in parts)} partitions of {least} returns or more, by {by}")
    return figure


def detections() -> Any:
    """Figure 4: walls and landmarks detected in one scan."""
    run = apartment()
    figure, (ax,) = new_axes(1, 1, 11.0, 8.2)
    draw_truth(ax, run.scene)
    drawing.draw_returns(ax, run.pose(SCAN), run.scans[SCAN], size=6.0)
    drawing.draw_detections(ax, run.pose(SCAN), run.features(SCAN))
    drawing.draw_robot(ax, run.pose(SCAN), run.trace.radius_m)
    legend(figure)
    return figure


def state() -> Any:
    """Figure 5: landmarks in the state with their covariance."""
    run = apartment()
    figure, (ax,) = new_axes(1, 1, 11.0, 8.2)
    draw_truth(ax, run.scene)
    plot.draw_landmarks(ax, run.trace, enlarged=10.0)
    path = np.array(run.trace.estimates)[:, :2]
    ax.plot(path[:, 0], path[:, 1], color=ESTIMATE, linewidth=1.0, label="estimated path")
    drawing.draw_robot(ax, run.trace.final.pose, run.trace.radius_m)
    legend(figure)
    return figure


def hit_grid() -> Any:
    """Figure 6: layout, detections, beams, hit grid."""
    run = apartment()
    pose = run.pose(SCAN)
    figure, axes = new_axes(2, 2, 12.0, 8.8)
    for ax, title in zip(axes, ("layout", "detected walls and landmarks", "laser", "hit grid so far"), strict=True):
        draw_truth(ax, run.scene, WALL if title == "layout" else "#C8C8C8")
        drawing.draw_robot(ax, pose, run.trace.radius_m)
        ax.set_title(title)
        ax.label_outer()
    drawing.draw_detections(axes[1], pose, run.features(SCAN))
    drawing.draw_beams(axes[2], pose, run.scans[SCAN])
    drawing.draw_hits(axes[3], run.grid(SCAN), run.trace.config.grid.cell_m)
    return figure


def made_at(run: Recording, plan: int) -> int:
    """The keyframe at which a plan was made."""
    return next(k for k, count in enumerate(run.plans) if count > plan)


def length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def replanning() -> Any:
    """Figure 7: a plan and its replacement, for the replan that increased the total path length most."""
    run = apartment()
    plans = run.trace.plans
    made = [made_at(run, n) for n in range(len(plans))]
    # Total length: the path driven until the plan was made, and the plan.
    costs = np.array([length(run.way(k)) + length(plan) for k, plan in zip(made, plans, strict=True)])
    i = int(np.argmax(np.diff(costs)))
    figure, axes = new_axes(1, 2, 13.0, 5.2)
    for ax, n, title in ((axes[0], i, "planned"), (axes[1], i + 1, "replanned")):
        k = made[n]
        draw_truth(ax, run.scene)
        drawing.draw_hits(ax, run.grid(k), run.trace.config.grid.cell_m)
        if n > i:
            ax.plot(*plans[i].T, color=PLAN, linewidth=1.0, linestyle=":", zorder=4, label="previous plan")
        drawing.draw_path(ax, plans[n])
        drawing.draw_robot(ax, run.pose(k), run.trace.radius_m)
        window(ax, np.concatenate(plans[i : i + 2]))
        ax.set_title(f"{title} at {run.time_s(k):.1f} s, {length(plans[n]):.1f} m to go")
    legend(figure)
    return figure


def trajectory() -> Any:
    """Figure 8: the three plans that the shortcut shortens most, with the current way point."""
    run = apartment()
    rows = []
    for n, plan in enumerate(run.trace.plans):
        k = made_at(run, n)
        optimised = shortcut(run.grid(k).free_space(plan[0], plan[-1]), plan)
        rows.append((length(plan) - length(optimised), k, plan, optimised))
    best = sorted(sorted(rows, key=lambda row: row[0])[-3:], key=lambda row: row[1])
    figure, axes = new_axes(1, 3, 15.0, 5.4)
    for ax, (gain, k, plan, optimised) in zip(axes, best, strict=True):
        draw_truth(ax, run.scene)
        drawing.draw_hits(ax, run.grid(k), run.trace.config.grid.cell_m)
        drawing.draw_path(ax, plan, optimised)
        drawing.draw_robot(ax, run.pose(k), run.trace.radius_m)
        window(ax, plan)
        change = f"{len(plan)} way points, {len(optimised)} after the shortcut, {100 * gain:.0f} cm saved"
        ax.set_title(f"{run.time_s(k):.1f} s: {change}", fontsize=10)
    legend(figure)
    return figure


def seen_region() -> Any:
    """Figure 9: the seen area."""
    run = apartment()
    figure, axes = new_axes(1, 2, 13.0, 5.0)
    for ax, k in zip(axes, (SCAN, len(run.scans) - 1), strict=True):
        draw_truth(ax, run.scene, WALL)
        space = run.grid(k).free_space()
        drawing.draw_seen(ax, space)
        ax.plot(*run.way(k).T, color=ESTIMATE, linewidth=1.2)
        drawing.draw_robot(ax, run.pose(k), run.trace.radius_m)
        ax.set_title(f"{run.time_s(k):.1f} s: {space.seen.sum() * space.cell_m**2:.0f} m² seen")
    return figure


def moments() -> Any:
    """Figure 10: moments of a run."""
    run = apartment()
    figure, axes = new_axes(3, 2, 12.0, 12.8)
    for ax, k in zip(axes, np.linspace(0, len(run.scans) - 1, 6).astype(int), strict=True):
        grid, landmarks = run.grid(k), run.trace.key_estimates[k].landmarks
        draw_truth(ax, run.scene)
        drawing.draw_seen(ax, grid.free_space())
        drawing.draw_hits(ax, grid, run.trace.config.grid.cell_m)
        if run.plans[k]:
            drawing.draw_path(ax, run.trace.plans[run.plans[k] - 1])
        ax.plot(*run.way(k).T, color=ESTIMATE, linewidth=1.4, zorder=6, label="estimated path")
        style = {"facecolors": "none", "edgecolors": OBSERVATION, "linewidths": 1.2, "zorder": 7}
        ax.scatter(landmarks[:, 0], landmarks[:, 1], s=22.0, label="landmarks in the state", **style)
        drawing.draw_robot(ax, run.pose(k), run.trace.radius_m)
        ax.set_title(f"{run.time_s(k):.1f} s")
        ax.label_outer()
    legend(figure)
    return figure


def iep() -> Any:
    """Figure 11: lines of first-level and second-level partitions, in the scan in which they differ most."""
    run = apartment()
    scene = run.scene
    poses = [Pose.from_array(row) for row in run.trace.key_truths]
    rough = [features_of(scan, WITHOUT_IEP) for scan in run.scans]
    fine = [run.features(k) for k in range(len(run.scans))]
    gain = [strays_m(p, a, scene) - strays_m(p, b, scene) for p, a, b in zip(poses, rough, fine, strict=True)]
    k = int(np.argmax(gain))
    figure, axes = new_axes(1, 2, 13.0, 6.4)
    for ax, features, of in ((axes[0], rough[k], "first"), (axes[1], fine[k], "second")):
        draw_truth(ax, scene, near=poses[k].position, reach_m=3.6)
        drawing.draw_returns(ax, poses[k], run.scans[k])
        drawing.draw_detections(ax, poses[k], features)
        drawing.draw_robot(ax, poses[k], run.trace.radius_m)
        off = strays_m(poses[k], features, scene)
        ax.set_title(f"lines of {of}-level partitions: maximum error {off:.2f} m")
    legend(figure)
    return figure


def culling() -> Any:
    """Figure 12: a bad landmark before and after its removal."""
    run = record(preset("default", **ROUGH))
    bad = drawing.worst_culled(run)
    figure, axes = new_axes(1, 2, 13.0, 6.4)
    for ax, k, event in (
        (axes[0], bad.gone - 1, f"initialised at {run.time_s(bad.born):.1f} s"),
        (axes[1], bad.gone, "culled"),
    ):
        landmarks = run.trace.key_estimates[k].landmarks
        draw_truth(ax, run.scene, near=bad.position, reach_m=2.5)
        ax.scatter(landmarks[:, 0], landmarks[:, 1], s=60.0, facecolors="none", edgecolors=OBSERVATION, linewidths=1.8,
                   label="landmarks in the state", zorder=6)  # fmt: skip
        true = true_landmarks(run.scene.walls)
        ax.scatter(true[:, 0], true[:, 1], s=30.0, marker="+", color=WALL, label="true corners and ends", zorder=7)
        ax.scatter(*bad.position, s=260.0, facecolors="none", edgecolors=LANDMARK, linewidths=1.2, zorder=5)
        distance = f"{bad.off_m:.2f} m from the nearest true one"
        ax.annotate(distance, bad.position, (0, 16), textcoords="offset points", ha="center")
        ax.set_title(f"{run.time_s(k):.1f} s: {event}")
    legend(figure)
    return figure


FIGURES: dict[int, tuple[str, Callable[[], Any]]] = {
    2: ("pipeline", pipeline),
    3: ("partitions", partitions),
    4: ("detections", detections),
    5: ("landmarks", state),
    6: ("hit_grid", hit_grid),
    7: ("replanning", replanning),
    8: ("trajectory", trajectory),
    9: ("seen", seen_region),
    10: ("moments", moments),
    11: ("iep", iep),
    12: ("culling", culling),
}


def shrink(file: Path) -> None:
    """Store a PNG with a palette, which keeps the repository small."""
    from PIL import Image

    with Image.open(file) as image:
        image.convert("RGB").quantize(128, dither=Image.Dither.NONE).save(file, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/figures"), metavar="DIR", help="folder to write into")
    parser.add_argument("--only", type=int, nargs="+", choices=[1, *FIGURES], metavar="N", help="only these figures")
    options = parser.parse_args()
    warm_up()
    for number in options.only or [1, *FIGURES]:
        name, make = FIGURES.get(number, ("calibration", None))
        file = options.out / f"figure{number:02d}_{name}.png"
        if make is None:
            calibration(file)
        else:
            plot.save(make(), file)
        shrink(file)
        print(f"{file}  {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
