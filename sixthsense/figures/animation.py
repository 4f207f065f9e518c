"""A run as a film: the map, the estimate and the plan at each moment, replayed from the run's folder."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from sixthsense.config import load_config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick, seconds
from sixthsense.figures import plot
from sixthsense.logs.runfolder import read_run
from sixthsense.loop.run import replay
from sixthsense.navigation.frontier import frontier_points
from sixthsense.record.store import prior_start
from sixthsense.record.trace import Trace
from sixthsense.record.writing import whole
from sixthsense.slam.prior_map import PriorStart

SUFFIXES = (".mp4", ".webp", ".gif")
"""File formats of a film."""
MOST_FRAMES = 150

_FRAMES_PER_S, _HELD, _DPI = 12.5, 20, 100  # the last frame is repeated so many times
_WIDTH_IN, _COLUMNS = 8.0, 4  # of the legend
_MOST_CELLS = 800  # on a side; a frame has no more pixels to show them with
_CELLS = ListedColormap(["#FFFFFF00", plot.SEEN, plot.OBSERVATION])

_DOT: dict[str, Any] = {"linestyle": "", "marker": "o", "markeredgewidth": 0.0}
_LINES: dict[str, dict[str, Any]] = {
    "walls": {"linewidth": 1.6, "color": plot.WALL, "label": "true walls"},
    "landmarks": {"linewidth": 1.2, "color": plot.LANDMARK, "label": "landmarks, 95 %"},
    "people": {"linewidth": 1.2, "color": plot.WALKER, "label": "people, true"},
    "returns": {**_DOT, "markersize": 2.2, "color": plot.ODOMETRY, "label": "laser returns", "zorder": 5},
    "frontiers": {**_DOT, "markersize": 2.2, "color": plot.TRUTH, "label": "frontiers", "zorder": 3},
    "plan": {"linewidth": 1.6, "color": plot.PLAN, "label": "planned path", "zorder": 5},
    "tour": {
        "marker": "o",
        "markersize": 2.6,
        "linewidth": 0.6,
        "color": plot.PLAN,
        "label": "tour of views",
        "zorder": 5,
    },
    "truth": {"linewidth": 1.1, "linestyle": (0, (4, 4)), "color": plot.TRUTH, "label": "true path", "zorder": 8},
    "path": {"linewidth": 1.4, "color": plot.ESTIMATE, "label": "estimated path", "zorder": 7},
    "heading": {"linewidth": 1.4, "color": plot.WALL, "zorder": 10},
}
"""style of each line of a frame, by name"""


def check_film(file: Path | str) -> None:
    """Raise InputError, with what is allowed, for a suffix not in SUFFIXES, or an MP4 without ffmpeg."""
    suffix = Path(file).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError("animate", f"found {str(file)!r}", "FILE.mp4, FILE.webp or FILE.gif")
    if suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError("animate", f"{file} needs the program ffmpeg, which is not installed", "FILE.webp or FILE.gif")


def film_prior(finished: Trace, prior_map: Path | str | None) -> PriorStart | None:
    """The prior map that a run began with, of which its record has the name alone; None if it began without.

    Raises InputError if the run began with one and `prior_map` is not its folder, and what `prior_start` raises.
    """
    note = finished.prior_map
    if note is None:
        if prior_map is not None:
            raise InputError("prior_map", "found with a run that began without a map", "without it")
        return None
    if prior_map is None:
        raise InputError("animate", f"found a run that began with the prior map {note['name']}", "with `prior_map`")
    is_lost = note.get("lost") is True
    start = prior_start(prior_map, note.get("pose"), None if is_lost else note.get("pose_sigma"), is_lost)
    if start is not None and start.map.digest != note["digest"]:
        raise InputError(
            "prior_map", f"found {prior_map}, another map than that of the run", f"{note['name']} as it was"
        )
    return start


def animate(
    folder: Path | str,
    finished: Trace,
    file: Path | str,
    title: str = "",
    frames: int = MOST_FRAMES,
    on_frame: Callable[[], object] = lambda: None,
    prior: PriorStart | None = None,
) -> None:
    """Write a film of the run in `folder` with up to `frames` frames, evenly spread over the run's scans.

    `finished` is the trace of that run: it gives the limits of the axes and the number of scans. The run is replayed,
    so each frame shows the map, the landmarks and their 95 % ellipses of its own moment; one that began with a prior
    map begins with `prior`, that of `film_prior`. `on_frame` is called after every frame. Raises InputError for a
    suffix not in SUFFIXES, for an MP4 without ffmpeg and for one that ffmpeg fails to write.
    """
    check_film(file)
    file = Path(file)
    config = load_config(Path(folder) / "config.toml")
    log = read_run(folder, config.laser)
    plans, tours = log.paths("plan"), log.paths("tour")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure, ax = _stage(finished, title, bool(tours))
    due = set(np.unique(np.linspace(0, len(finished.stamps_ns) - 1, max(frames, 2)).round().astype(int)).tolist())
    writer = _writer(file)

    def show(tick: Tick, trace: Trace) -> None:
        if (tick.scan is None and tick.observations is None) or len(trace.stamps_ns) - 1 not in due:
            return
        _draw(ax, finished, trace, tick, _latest(plans, tick.stamp_ns), _latest(tours, tick.stamp_ns))
        writer.grab_frame()
        on_frame()

    try:
        with whole(file) as partial, writer.saving(figure, str(partial), _DPI):
            replay(log, config, on_tick=show, prior=prior)
            for _ in range(_HELD - 1):
                writer.grab_frame()
    except (BrokenPipeError, subprocess.CalledProcessError):
        raise InputError("animate", f"ffmpeg cannot write {file}", "FILE.webp or FILE.gif") from None


def _writer(file: Path) -> AbstractMovieWriter:
    """Matplotlib's writer for the format; the index at the beginning of an MP4 lets a browser play it at once."""
    if file.suffix.lower() == ".mp4":
        return FFMpegWriter(fps=_FRAMES_PER_S, codec="h264", extra_args=["-movflags", "+faststart"])  # type: ignore[arg-type]
    return PillowWriter(fps=_FRAMES_PER_S)  # type: ignore[arg-type]


def _stage(finished: Trace, title: str, has_tours: bool) -> tuple[Any, Any]:
    """The figure of a film and its axes, with limits, a legend, and a layout that stays."""
    shown = {
        "walls": finished.scene, "people": finished.walkers, "frontiers": _region(finished), "plan": finished.plans,
        "tour": has_tours, "truth": finished.truths,
    }  # fmt: skip
    figure: Any = plot.new_figure(_WIDTH_IN, _WIDTH_IN)
    ax: Any = figure.add_subplot()
    plot.draw_map(ax, finished)
    limits = ax.get_xlim(), ax.get_ylim()
    ax.clear()
    ax.set(xlim=limits[0], ylim=limits[1], title=" ")
    plot.label_plane(ax)
    lines = [Line2D([], [], **style) for name, style in _LINES.items() if "label" in style and shown.get(name, True)]
    figure.legend(handles=lines, loc="outside lower center", ncols=_COLUMNS, frameon=False, fontsize=9)
    figure.suptitle(title, fontsize=11)
    # H.264 requires an even number of pixels.
    height = plot.map_height(ax, _WIDTH_IN) + 0.2 * (-(-len(lines) // _COLUMNS) - 1)
    figure.set_size_inches(_WIDTH_IN, 2.0 * round(0.5 * height * _DPI) / _DPI)
    figure.set_dpi(_DPI)
    figure.canvas.draw()
    figure.set_layout_engine("none")  # the layout is settled: a caption's length must not move the axes
    return figure, ax


def _region(finished: Trace) -> Any:
    """Where an exploration looks for frontiers; None of another run."""
    if finished.config.task != "explore" or finished.scene is None:
        return None
    return finished.config.region or finished.scene.region


def _draw(ax: Any, finished: Trace, trace: Trace, tick: Tick, plan: Array, tour: Array) -> None:
    """Draw the trace's newest tick, with the plan and tour (N, 2) of then, world frame."""
    limits = ax.get_xlim(), ax.get_ylim()
    ax.clear()
    grid, live, cell_m = trace.draw_map(), trace.live, trace.config.grid.cell_m
    assert grid is not None and live is not None
    if (known := plot.known_blocks(trace, _MOST_CELLS)) is not None:
        cells = np.select([known[0] == 100, known[0] == 0], [2, 1], 0)
        style = {"origin": "lower", "interpolation": "nearest", "zorder": 0}
        ax.imshow(cells, cmap=_CELLS, vmin=0, vmax=2, extent=known[1], **style)
    if finished.scene is not None:
        plot.draw_segments(ax, finished.scene.walls, colors=plot.WALL, linewidths=1.6, zorder=1)
    if finished.walkers:
        people = plot.walker_outlines(finished.walkers[len(trace.estimates) - 1])
        plot.draw_segments(ax, np.array(people), colors=plot.WALKER, zorder=8)
    plot.draw_landmarks(ax, trace)
    pose, area_m2 = Pose.from_array(trace.estimates[-1]), grid.seen_area_m2
    shown = {"plan": plan, "path": np.array(trace.estimates)[:, :2]}
    shown["heading"] = np.stack([pose.position, pose @ np.array([trace.radius_m, 0.0])])
    if live.scan is not None:
        shown["returns"] = pose @ live.scan.returns_robot
    if (region := _region(finished)) is not None:
        shown["frontiers"] = frontier_points(grid.seen, grid.obstacles, grid.origin, cell_m, region)
    if len(tour):
        shown["tour"] = np.vstack([pose.position, tour[1:]])
    if trace.truths:
        shown["truth"] = np.array(trace.truths)[:, :2]
    for name, points in shown.items():
        ax.plot(*points.T, **_LINES[name])
    ax.add_patch(
        Circle((pose.x, pose.y), trace.radius_m, facecolor="white", edgecolor=plot.WALL, linewidth=1.4, zorder=9)
    )
    parts = [f"{seconds(tick.stamp_ns - trace.stamps_ns[0]):7.1f} s", *([f"{area_m2:.0f} m² seen"] if area_m2 else [])]
    if trace.key_estimates:
        parts.append(f"{len(trace.key_estimates[-1].ids)} landmarks")
    ax.set_title(" · ".join(parts), loc="left", fontsize=10)
    plot.label_plane(ax)
    ax.set(xlim=limits[0], ylim=limits[1])


def _latest(paths: Sequence[tuple[int, Array]], stamp_ns: int) -> Array:
    """The last of the paths with stamps that were made by then; (0, 2) before the first."""
    return next((path for made_ns, path in reversed(paths) if made_ns <= stamp_ns), np.zeros((0, 2)))
