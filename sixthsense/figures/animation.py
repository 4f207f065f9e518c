"""A run as a film: the map, the estimate and the plan at each moment, replayed from the run's folder."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from PIL import Image

from sixthsense.config import load_config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick, seconds
from sixthsense.figures.plot import (
    ESTIMATE,
    LANDMARK,
    OBSERVATION,
    ODOMETRY,
    PLAN,
    SEEN,
    TRUTH,
    WALKER,
    WALL,
    draw_segments,
    ellipse,
    known_blocks,
    label_plane,
    landmarks_of,
    map_height,
    new_figure,
    walker_outlines,
)
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

_FRAMES_PER_S = 12.5
_HELD = 20  # repetitions of the last frame
_WIDTH_IN = {".mp4": 9.0, ".webp": 9.0, ".gif": 7.0}
_DPI = 100
_GIF_COLORS = 64
_OCTREE = Image.Quantize.FASTOCTREE
_WEBP_QUALITY = 30
_COLUMNS, _ROW_IN = 4, 0.2  # of the legend
_MOST_CELLS = 800  # on a side; a frame has no more pixels to show them with

_DOT: dict[str, Any] = {"linestyle": "", "marker": "o", "markeredgewidth": 0.0}
_LINES: dict[str, dict[str, Any]] = {
    "points": {**_DOT, "markersize": 2.6, "color": LANDMARK, "label": "landmarks, 95 %", "zorder": 6},
    "returns": {**_DOT, "markersize": 2.2, "color": ODOMETRY, "label": "laser returns", "zorder": 5},
    "frontiers": {**_DOT, "markersize": 2.2, "color": TRUTH, "label": "frontiers", "zorder": 3},
    "plan": {"linewidth": 1.6, "color": PLAN, "label": "planned path", "zorder": 5},
    "tour": {"marker": "o", "markersize": 2.6, "linewidth": 0.6, "color": PLAN, "label": "tour of views", "zorder": 5},
    "truth": {"linewidth": 1.1, "linestyle": (0, (4, 4)), "color": TRUTH, "label": "true path", "zorder": 8},
    "path": {"linewidth": 1.4, "color": ESTIMATE, "label": "estimated path", "zorder": 7},
    "pose": {"linewidth": 1.0, "color": ESTIMATE, "zorder": 10},
    "heading": {"linewidth": 1.4, "color": WALL, "zorder": 10},
}
"""style of each line of points of a frame, by name"""


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
    drawing = _MapDrawing(finished, title, _WIDTH_IN[file.suffix.lower()], has_tours=bool(tours))
    due = set(np.unique(np.linspace(0, len(finished.stamps_ns) - 1, max(frames, 2)).round().astype(int)).tolist())
    with _opened_film(drawing.figure, file) as writer:

        def show(tick: Tick, trace: Trace) -> None:
            if (tick.scan is None and tick.observations is None) or len(trace.stamps_ns) - 1 not in due:
                return
            drawing.show(tick, trace, _latest(plans, tick.stamp_ns), _latest(tours, tick.stamp_ns))
            writer.grab_frame()
            on_frame()

        replay(log, config, on_tick=show, prior=prior)
        for _ in range(_HELD - 1):
            writer.grab_frame()


@contextmanager
def _opened_film(figure: Any, file: Path) -> Iterator[AbstractMovieWriter]:
    """Matplotlib's writer for the file's format. The file appears once all its frames are written."""
    writer: AbstractMovieWriter
    if file.suffix.lower() == ".mp4":
        # The index at the file's beginning lets a browser play it before all of it is loaded.
        index = ["-movflags", "+faststart"]
        writer = FFMpegWriter(fps=_FRAMES_PER_S, codec="h264", extra_args=index)  # type: ignore[arg-type]
    else:
        writer = _ImageWriter(fps=_FRAMES_PER_S)  # type: ignore[arg-type]
    try:
        with whole(file) as partial, writer.saving(figure, str(partial), _DPI):
            yield writer
    except (BrokenPipeError, subprocess.CalledProcessError):
        raise InputError("animate", f"ffmpeg cannot write {file}", "FILE.webp or FILE.gif") from None


class _ImageWriter(PillowWriter):
    """Matplotlib's writer of GIF and WebP: a GIF with fewer colours, which halves the file, WebP with loss."""

    _frames: list[Image.Image]  # of the base class

    def finish(self) -> None:
        first, *others = map(_few_colors, self._frames) if str(self.outfile).lower().endswith(".gif") else self._frames
        options: dict[str, Any] = {"duration": round(1e3 / self.fps), "loop": 0, "quality": _WEBP_QUALITY}
        first.save(self.outfile, save_all=True, append_images=others, **options)


def _few_colors(frame: Image.Image) -> Image.Image:
    return frame.quantize(_GIF_COLORS, _OCTREE, dither=Image.Dither.NONE)


class _MapDrawing:
    """A map figure whose artists are moved from frame to frame."""

    def __init__(self, finished: Trace, title: str, width_in: float, has_tours: bool) -> None:
        """Draw what stays the same, and empty artists for what moves."""
        from matplotlib.collections import LineCollection, PolyCollection
        from matplotlib.colors import ListedColormap
        from matplotlib.patches import Circle

        self._config, self._tracks, scene = finished.config, finished.walkers, finished.scene
        explores = self._config.task == "explore" and scene is not None
        self._region = (self._config.region or scene.region) if explores and scene is not None else None
        self.figure: Any = new_figure(width_in, width_in)
        ax: Any = self.figure.add_subplot()
        colors = ListedColormap(["#FFFFFF00", SEEN, OBSERVATION])
        style = {"origin": "lower", "interpolation": "nearest", "zorder": 0}
        self._image = ax.imshow(np.zeros((1, 1)), cmap=colors, vmin=0, vmax=2, **style)
        if scene is not None:
            draw_segments(ax, scene.walls, colors=WALL, linewidths=1.6, label="true walls", zorder=1)
        name = "people, true" if self._tracks else None
        self._people = ax.add_collection(LineCollection([], colors=WALKER, label=name, zorder=8))
        walls = LineCollection([], colors=LANDMARK, linewidths=1.4, label="estimated walls", zorder=4)
        self._walls = ax.add_collection(walls)
        ellipses = PolyCollection([], facecolors="none", edgecolors=LANDMARK, linewidths=0.9, zorder=6)
        self._ellipses = ax.add_collection(ellipses)
        shown = {"frontiers": self._region, "plan": finished.plans, "tour": has_tours, "truth": finished.truths}
        self._lines = {name: ax.plot([], [], **style)[0] for name, style in _LINES.items() if shown.get(name, True)}
        robot = Circle((0.0, 0.0), finished.radius_m, facecolor="white", edgecolor=WALL, linewidth=1.4, zorder=9)
        self._robot = ax.add_patch(robot)
        self._caption = ax.set_title(" ", loc="left", fontsize=10)
        label_plane(ax)
        low, high = _limits(finished)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        if title:
            self.figure.suptitle(title, fontsize=11)
        legend = self.figure.legend(loc="outside lower center", ncols=_COLUMNS, frameon=False, fontsize=9)
        rows = -(-len(legend.get_texts()) // _COLUMNS)
        self.figure.set_size_inches(width_in, _even(map_height(ax, width_in) + _ROW_IN * (rows - 1)))
        self.figure.set_dpi(_DPI)
        self.figure.canvas.draw()
        self.figure.set_layout_engine("none")  # the layout is settled: a caption's length must not move the axes

    def show(self, tick: Tick, trace: Trace, plan: Array, tour: Array) -> None:
        """Move the artists to the trace's newest tick, with the plan and tour (N, 2) of then, world frame."""
        live, grid = trace.live, trace.draw_map()
        assert live is not None and grid is not None
        pose = Pose.from_array(trace.estimates[-1])
        points, covs, extents = landmarks_of(trace)
        self._ellipses.set_verts([ellipse(mean, cov) for mean, cov in zip(points, covs, strict=True)])
        self._walls.set_segments(extents)
        shown = {"points": points, "plan": plan, "path": np.array(trace.estimates)[:, :2]}
        shown["heading"] = np.stack([pose.position, pose @ np.array([trace.radius_m, 0.0])])
        parts, seen = [f"{seconds(tick.stamp_ns - trace.stamps_ns[0]):7.1f} s"], grid.seen
        if seen.any():
            parts.append(f"{np.count_nonzero(seen) * self._config.grid.cell_m**2:.0f} m² seen")
        if trace.key_estimates:
            shown["pose"] = ellipse(pose.position, trace.key_estimates[-1].pose_cov[:2, :2])
            parts.append(f"{len(trace.key_estimates[-1].ids)} landmarks")
        if live.scan is not None:
            shown["returns"] = pose @ live.scan.points_robot[live.scan.is_return]
        if self._region is not None:
            cell_m, origin = self._config.grid.cell_m, grid.origin
            shown["frontiers"] = frontier_points(seen, grid.obstacles, origin, cell_m, self._region)
        if len(tour):
            shown["tour"] = np.vstack([pose.position, tour[1:]])
        if trace.truths:
            shown["truth"] = np.array(trace.truths)[:, :2]
        for name in shown.keys() & self._lines.keys():
            self._lines[name].set_data(*shown[name].T)
        if self._tracks:
            self._people.set_segments(walker_outlines(self._tracks[len(trace.estimates) - 1]))
        self._robot.set_center((pose.x, pose.y))
        self._caption.set_text(" · ".join(parts))
        self._show_cells(trace)

    def _show_cells(self, trace: Trace) -> None:
        """Show the known cells, in blocks where they are more than the pixels of a frame."""
        known = known_blocks(trace, _MOST_CELLS)
        if known is None:
            return
        blocks, extent = known
        self._image.set_data(np.select([blocks == 100, blocks == 0], [2, 1], 0))
        self._image.set_extent(extent)


def _latest(paths: Sequence[tuple[int, Array]], stamp_ns: int) -> Array:
    """The last of the paths with stamps that were made by then; (0, 2) before the first."""
    return next((path for made_ns, path in reversed(paths) if made_ns <= stamp_ns), np.zeros((0, 2)))


def _limits(finished: Trace) -> tuple[Array, Array]:
    """Lower left and upper right corner (2,) of the axes: around the path, the landmarks, and the scene or the map."""
    shown = [np.array(finished.estimates).reshape(-1, 3)[:, :2], finished.final.landmarks[~finished.final.walls]]
    if finished.scene is not None:
        shown.append(finished.scene.walls.reshape(-1, 2))
    elif finished.grid is not None:
        known = np.argwhere(finished.grid.occupancy() == 100)[:, ::-1]
        shown.append(known * finished.config.grid.cell_m + np.array(finished.grid.origin))
    points = np.concatenate(shown)
    slack = 0.5 + 0.01 * np.ptp(points, axis=0).max()
    return points.min(axis=0) - slack, points.max(axis=0) + slack


def _even(height_in: float) -> float:
    """A height of an even number of pixels, which H.264 requires."""
    return 2.0 * round(0.5 * height_in * _DPI) / _DPI
