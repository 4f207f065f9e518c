"""A run as a film: the map, the estimate and the plan at each moment, replayed from the run's folder."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.lines import Line2D

from sixthsense.config import load_config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick, seconds
from sixthsense.figures import plot
from sixthsense.logs.runfolder import FILE, paths_of, read_messages, read_run
from sixthsense.loop.run import replay
from sixthsense.record.trace import Trace
from sixthsense.record.writing import whole

SUFFIXES = (".mp4", ".webp", ".gif")
"""File formats of a film."""
MOST_FRAMES = 150

_FRAMES_PER_S, _HELD, _DPI = 12.5, 20, 100  # the last frame is repeated so many times
_WIDTH_IN, _COLUMNS = 8.0, 4  # of the legend

_DOT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 2.2, "markeredgewidth": 0.0, "zorder": 5}
_LINES: dict[str, dict[str, Any]] = {
    "walls": {"linewidth": 1.6, "color": plot.WALL, "label": "true walls"},
    "landmarks": {"linewidth": 1.2, "color": plot.LANDMARK, "label": "landmarks, 95 %"},
    "people": {"linewidth": 1.2, "color": plot.WALKER, "label": "people, true"},
    "returns": {**_DOT, "color": plot.ODOMETRY, "label": "laser returns"},
    "frontiers": {**_DOT, "color": plot.TRUTH, "label": "frontiers", "zorder": 3},
    "plan": {"linewidth": 1.6, "color": plot.PLAN, "label": "planned path", "zorder": 5},
    "tour": {**_DOT, "linestyle": "-", "linewidth": 0.6, "color": plot.PLAN, "label": "tour of views"},
    "truth": {"linewidth": 1.1, "linestyle": (0, (4, 4)), "color": plot.TRUTH, "label": "true path", "zorder": 8},
    "path": {"linewidth": 1.4, "color": plot.ESTIMATE, "label": "estimated path", "zorder": 7},
}
"""style of each line of a frame, by name"""


def check_film(file: Path | str, finished: Trace) -> None:
    """Raise InputError, with what is allowed, for a film of `finished` that cannot be made.

    That is a suffix not in SUFFIXES, an MP4 without ffmpeg, and a run that began with a prior map: its record has no
    map to replay it with.
    """
    suffix = Path(file).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError("animate", f"found {str(file)!r}", "FILE.mp4, FILE.webp or FILE.gif")
    if suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError("animate", f"{file} needs the program ffmpeg, which is not installed", "FILE.webp or FILE.gif")
    if finished.prior_map is not None:
        found = f"found a run that began with the prior map {finished.prior_map['name']}"
        raise InputError("animate", found, "a run that began without a map")


def animate(
    folder: Path | str,
    finished: Trace,
    file: Path | str,
    title: str = "",
    frames: int = MOST_FRAMES,
    on_frame: Callable[[], object] = lambda: None,
) -> None:
    """Write a film of the run in `folder` with up to `frames` frames, evenly spread over the run's scans.

    `finished` is the trace of that run: it gives the limits of the axes and the number of scans. The run is replayed,
    so each frame shows the map, the landmarks and their 95 % ellipses of its own moment. `on_frame` is called after
    every frame. Raises InputError as `check_film`, and for an MP4 that ffmpeg fails to write.
    """
    check_film(file, finished)
    file, config = Path(file), load_config(Path(folder) / "config.toml")
    log, (messages, _) = read_run(folder, config.laser), read_messages(Path(folder) / FILE)
    paths = {name: paths_of(messages, name) for name in ("plan", "tour")}
    file.parent.mkdir(parents=True, exist_ok=True)
    figure, ax = _stage(finished, title, bool(paths["tour"]))
    due = set(np.linspace(0, len(finished.stamps_ns) - 1, max(frames, 2)).round().astype(int).tolist())
    writer: Any = PillowWriter(fps=_FRAMES_PER_S)  # type: ignore[arg-type]
    if file.suffix.lower() == ".mp4":  # whose index at the beginning lets a browser play it at once
        writer = FFMpegWriter(fps=_FRAMES_PER_S, codec="h264", extra_args=["-movflags", "+faststart"])  # type: ignore[arg-type]

    def show(tick: Tick, trace: Trace) -> None:
        if (tick.scan is not None or tick.observations is not None) and len(trace.stamps_ns) - 1 in due:
            _draw(ax, finished, trace, tick, {name: _latest(made, tick.stamp_ns) for name, made in paths.items()})
            writer.grab_frame()
            on_frame()

    try:
        with whole(file) as partial, writer.saving(figure, str(partial), _DPI):
            replay(log, config, on_tick=show)
            for _ in range(_HELD - 1):
                writer.grab_frame()
    except (BrokenPipeError, subprocess.CalledProcessError):
        raise InputError("animate", f"ffmpeg cannot write {file}", "FILE.webp or FILE.gif") from None


def _stage(finished: Trace, title: str, has_tours: bool) -> tuple[Any, Any]:
    """The figure of a film and its axes, with limits, a legend, and a layout that stays."""
    shown = {
        "walls": finished.scene, "people": finished.walkers, "frontiers": finished.config.task == "explore",
        "plan": finished.plans, "tour": has_tours, "truth": finished.truths,
    }  # fmt: skip
    figure: Any = plot.new_figure(_WIDTH_IN, _WIDTH_IN)
    ax: Any = figure.add_subplot()
    plot.draw_map(ax, finished)
    ax.set_autoscale_on(False)
    ax.set_title(" ", loc="left", fontsize=10)
    lines = [Line2D([], [], **style) for name, style in _LINES.items() if "label" in style and shown.get(name, True)]
    figure.legend(handles=lines, loc="outside lower center", ncols=_COLUMNS, frameon=False, fontsize=9)
    figure.suptitle(title, fontsize=11)
    # H.264 requires an even number of pixels.
    height = plot.map_height(ax, _WIDTH_IN) + 0.2 * (-(-len(lines) // _COLUMNS) - 1)
    figure.set_size_inches(_WIDTH_IN, 2.0 * round(0.5 * height * _DPI) / _DPI)
    figure.canvas.draw()
    figure.set_layout_engine("none")  # the layout is settled: a caption's length must not move the axes
    return figure, ax


def _draw(ax: Any, finished: Trace, trace: Trace, tick: Tick, shown: dict[str, Array]) -> None:
    """Draw the newest tick in place of the one before; `shown` has plan and tour (N, 2) of then, world frame."""
    grid, live = trace.draw_map(), trace.live
    assert grid is not None and live is not None
    pose, area_m2 = Pose.from_array(trace.estimates[-1]), grid.seen_area_m2
    parts = [f"{seconds(tick.stamp_ns - trace.stamps_ns[0]):7.1f} s", *([f"{area_m2:.0f} m² seen"] if area_m2 else [])]
    parts += [f"{len(trace.key_estimates[-1].ids)} landmarks"] if trace.key_estimates else []
    for artist in (*ax.lines, *ax.collections, *ax.images, *ax.patches):
        artist.remove()
    ax.set_title(" · ".join(parts), loc="left", fontsize=10)
    plot.draw_grid(ax, trace, plot.SEEN, plot.OBSERVATION)
    if finished.scene is not None:
        plot.draw_segments(ax, finished.scene.walls, colors=plot.WALL, linewidths=1.6, zorder=1)
    if finished.walkers:
        people = plot.walker_outlines(finished.walkers[len(trace.estimates) - 1])
        plot.draw_segments(ax, np.array(people), colors=plot.WALKER, zorder=8)
    plot.draw_landmarks(ax, trace)
    shown["path"] = np.array(trace.estimates)[:, :2]
    if live.scan is not None:
        shown["returns"] = pose @ live.scan.returns_robot
    if trace.config.task == "explore":
        shown["frontiers"] = plot.frontiers(trace)
    if len(shown["tour"]):
        shown["tour"] = np.vstack([pose.position, shown["tour"][1:]])
    if trace.truths:
        shown["truth"] = np.array(trace.truths)[:, :2]
    for name, points in shown.items():
        ax.plot(*points.T, **_LINES[name])
    ax.fill(*plot.outline(pose, trace.radius_m).T, facecolor="white", edgecolor=plot.WALL, linewidth=1.4, zorder=9)


def _latest(paths: Sequence[tuple[int, Array]], stamp_ns: int) -> Array:
    """The last of the paths with stamps that were made by then; (0, 2) before the first."""
    return next((path for made_ns, path in reversed(paths) if made_ns <= stamp_ns), np.zeros((0, 2)))
