"""A run as a film: what was seen, believed and planned as time goes by, replayed from the folder of the run."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import load_config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick
from sixthsense.figures.plot import (
    ESTIMATE,
    LANDMARK,
    ODOMETRY,
    PLAN,
    SEEN,
    SIGHTING,
    TRUTH,
    WALL,
    draw_segments,
    ellipse,
    label_plane,
    map_height,
    new_figure,
)
from sixthsense.loop import replay
from sixthsense.navigation.frontier import frontier_points
from sixthsense.record.trace import Trace
from sixthsense.sources.logs.runfolder import read_run

SUFFIXES = (".mp4", ".gif")
"""What a film can be written as."""
MOST_FRAMES = 150

Frame = NDArray[np.uint8]

_FRAME_MS = 80
_HELD = 20  # times that the last frame is shown
_WIDTH_IN = {".mp4": 9.0, ".gif": 7.0}
_DPI = 100
_GIF_COLORS = 64
_MOST_CELLS = 800  # on a side; a frame has no more pixels to show them with


class AnimationError(InputError):
    """One line for a film that cannot be made."""


def check_film(file: Path | str) -> None:
    """Raise AnimationError, saying what is allowed, for a file of another kind, and for an MP4 where ffmpeg is missing.

    A film is an .mp4 or a .gif.
    """
    suffix = Path(file).suffix.lower()
    if suffix not in SUFFIXES:
        raise AnimationError(f"--animate: found {str(file)!r}, allowed: FILE.mp4 or FILE.gif")
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise AnimationError(f"--animate: {file} needs the program ffmpeg, which is not installed, allowed: FILE.gif")


def animate(
    folder: Path | str,
    ended: Trace,
    file: Path | str,
    title: str = "",
    frames: int = MOST_FRAMES,
    on_frame: Callable[[], object] = lambda: None,
) -> None:
    """Write a film of the run in `folder`, at most so many frames evenly spread over its scans.

    `ended` is that run's trace: it says how large the plane is and when it is over. The run is replayed, so that the
    map, the landmarks and their 95 % ellipses are those of each moment. `on_frame` is called after every frame. Raises
    AnimationError for a suffix other than .mp4 and .gif, for an MP4 without ffmpeg or one that ffmpeg fails to write.
    """
    check_film(file)
    file = Path(file)
    config = load_config(Path(folder) / "config.toml")
    log = read_run(folder, config.laser)
    file.parent.mkdir(parents=True, exist_ok=True)
    stage = _Stage(ended, title, _WIDTH_IN[file.suffix.lower()])
    due = set(np.unique(np.linspace(0, len(ended.stamps_ns) - 1, max(frames, 2)).round().astype(int)).tolist())
    writer: _Writer = _Mp4(file) if file.suffix.lower() == ".mp4" else _Gif(file)

    def show(tick: Tick, trace: Trace) -> None:
        if (tick.scan is None and tick.sightings is None) or len(trace.stamps_ns) - 1 not in due:
            return
        k = int(np.searchsorted(log.plan_stamps_ns, tick.stamp_ns, side="right"))
        stage.show(tick, trace, log.plans[k - 1] if k else np.zeros((0, 2)))
        writer.add(stage.frame())
        on_frame()

    replay(log, config, on_tick=show)
    writer.close()


class _Stage:
    """The figure: its frame is drawn once, and upon it the artists that move, each time."""

    def __init__(self, ended: Trace, title: str, width_in: float) -> None:
        from matplotlib.collections import LineCollection, PolyCollection
        from matplotlib.colors import ListedColormap
        from matplotlib.patches import Circle

        self._config = ended.config
        self._truth = bool(ended.truths)
        scene = ended.scene
        explores = ended.config.task == "explore" and scene is not None
        self._region = (ended.config.region or scene.region) if explores and scene is not None else None
        self.figure: Any = new_figure(width_in, width_in)
        ax = self.figure.add_subplot()
        low, high = _limits(ended)
        self._cells = _Cells(low, high, ended.config.grid.cell_m)
        colors = ListedColormap(["#FFFFFF00", SEEN, SIGHTING])
        self._image = ax.imshow(
            self._cells.empty(), cmap=colors, vmin=0, vmax=2, origin="lower", extent=self._cells.extent,
            interpolation="nearest", zorder=0,
        )  # fmt: skip
        if scene is not None:
            draw_segments(ax, scene.walls, colors=WALL, linewidths=1.6, label="walls, true", zorder=1)
        line: dict[str, Any] = {"marker": "", "linestyle": "-"}
        dot: dict[str, Any] = {"linestyle": "", "marker": "o", "markeredgewidth": 0.0}
        self._walls = LineCollection([], colors=LANDMARK, linewidths=1.4, label="walls, estimated", zorder=4)
        self._ellipses = PolyCollection([], facecolors="none", edgecolors=LANDMARK, linewidths=0.9, zorder=6)
        ax.add_collection(self._walls)
        ax.add_collection(self._ellipses)
        (self._points,) = ax.plot([], [], **dot, markersize=2.6, color=LANDMARK, label="landmarks, 95 %", zorder=6)
        (self._returns,) = ax.plot([], [], **dot, markersize=2.2, color=ODOMETRY, label="scan", zorder=5)
        if self._region is not None:
            (self._frontiers,) = ax.plot([], [], **dot, markersize=2.2, color=TRUTH, label="frontiers", zorder=3)
        if ended.plans:
            (self._plan,) = ax.plot([], [], **line, linewidth=1.6, color=PLAN, label="planned", zorder=5)
        if self._truth:
            style: dict[str, Any] = {"color": TRUTH, "linewidth": 1.1, "linestyle": (0, (4, 4)), "zorder": 8}
            (self._driven,) = ax.plot([], [], label="driven, true", **style)
        (self._estimated,) = ax.plot([], [], **line, linewidth=1.4, color=ESTIMATE, label="driven, estimated", zorder=7)
        (self._sure,) = ax.plot([], [], **line, linewidth=1.0, color=ESTIMATE, zorder=10)
        (self._nose,) = ax.plot([], [], **line, linewidth=1.4, color=WALL, zorder=10)
        self._robot = Circle((0.0, 0.0), ended.radius_m, facecolor="white", edgecolor=WALL, linewidth=1.4, zorder=9)
        ax.add_patch(self._robot)
        self._clock = ax.set_title(" ", loc="left", fontsize=10)
        label_plane(ax)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        if title:
            self.figure.suptitle(title, fontsize=11)
        self.figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)
        self.figure.set_size_inches(width_in, _even(map_height(ax, width_in) + 0.15))
        self.figure.set_dpi(_DPI)
        self._ax = ax
        self._moving = sorted((*ax.images, *ax.collections, *ax.lines, *ax.patches, self._clock), key=_height)
        for artist in self._moving:
            artist.set_animated(True)
        self.figure.canvas.draw()
        canvas: Any = self.figure.canvas
        self._behind = canvas.copy_from_bbox(self.figure.bbox)

    def frame(self) -> Frame:
        """(H, W, 3) the figure as it is now."""
        canvas = self.figure.canvas
        canvas.restore_region(self._behind)
        for artist in self._moving:
            self._ax.draw_artist(artist)
        return np.array(np.asarray(canvas.buffer_rgba())[:, :, :3])

    def show(self, tick: Tick, trace: Trace, plan: Array) -> None:
        """Move everything to a tick, the trace's newest, and the plan (N, 2) of that time."""
        live = trace.live
        assert live is not None and trace.grid is not None
        estimate, pose = trace.key_estimates[-1] if trace.key_estimates else None, Pose.from_array(trace.estimates[-1])
        self._image.set_data(self._cells.shades(trace.grid.occupancy(), trace.grid.origin))
        seen = trace.grid.seen
        if estimate is not None:
            points = estimate.landmarks[~estimate.walls]
            covs = live.point_covariances(estimate)
            self._points.set_data(*points.T)
            self._ellipses.set_verts([ellipse(mean, cov) for mean, cov in zip(points, covs, strict=True)])
            extents = [live.records[i].extent for i in estimate.ids[estimate.walls].tolist() if i in live.records]
            self._walls.set_segments(extents)
            self._sure.set_data(*ellipse(pose.position, estimate.pose_cov[:2, :2]).T)
        if live.scan is not None:
            returned = live.scan.ranges < live.scan.max_range
            self._returns.set_data(*(pose @ live.scan.points_robot[returned]).T)
        if self._region is not None:
            cell_m = self._config.grid.cell_m
            edge = frontier_points(seen, trace.grid.obstacles, trace.grid.origin, cell_m, self._region)
            self._frontiers.set_data(*edge.T)
        if len(plan):
            self._plan.set_data(*plan.T)
        if self._truth:
            self._driven.set_data(*np.array(trace.truths)[:, :2].T)
        self._estimated.set_data(*np.array(trace.estimates)[:, :2].T)
        self._robot.center = pose.x, pose.y
        self._nose.set_data(*np.stack([pose.position, pose @ np.array([trace.radius_m, 0.0])]).T)
        words = [f"{1e-9 * (tick.stamp_ns - trace.stamps_ns[0]):7.1f} s"]
        if seen.any():
            words.append(f"{np.count_nonzero(seen) * self._config.grid.cell_m**2:.0f} m² seen")
        if estimate is not None:
            words.append(f"{len(estimate.ids)} landmarks")
        self._clock.set_text(" · ".join(words))


class _Cells:
    """The cells of a part of the plane as an image, coarser where there are more than can be seen."""

    def __init__(self, low: Array, high: Array, cell_m: float) -> None:
        self._first = np.floor(low[::-1] / cell_m).astype(np.int64)  # row, col
        self._cell_m = cell_m
        past = np.ceil(high[::-1] / cell_m).astype(np.int64)
        self._step = max(1, -(-int((past - self._first).max()) // _MOST_CELLS))
        self._shape = tuple((-(-(past - self._first) // self._step)).tolist())

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top, metres."""
        row, col = self._first
        side = self._step * self._cell_m
        height, width = self._shape
        return (
            col * self._cell_m,
            col * self._cell_m + width * side,
            row * self._cell_m,
            row * self._cell_m + height * side,
        )

    def empty(self) -> NDArray[np.uint8]:
        """Nothing seen."""
        return np.zeros(self._shape, dtype=np.uint8)

    def shades(self, occupancy: NDArray[np.int8], origin: tuple[float, float]) -> NDArray[np.uint8]:
        """0 unseen, 1 seen, 2 obstacle, of (H, W) cells whose lower left corner lies at `origin`."""
        image = self.empty()
        rows, cols = np.nonzero(occupancy >= 0)
        shades = np.where(occupancy[rows, cols] == 100, 2, 1)
        first = round(origin[1] / self._cell_m), round(origin[0] / self._cell_m)
        at = [(cells + first[k] - self._first[k]) // self._step for k, cells in enumerate((rows, cols))]
        inside = (at[0] >= 0) & (at[0] < image.shape[0]) & (at[1] >= 0) & (at[1] < image.shape[1])
        np.maximum.at(image, (at[0][inside], at[1][inside]), shades[inside].astype(np.uint8))
        return image


def _limits(ended: Trace) -> tuple[Array, Array]:
    """Corners (2,) of what is to be seen: where the robot was, the scene, or else the known part of the map."""
    shown = [np.array(ended.estimates).reshape(-1, 3)[:, :2], ended.final.landmarks[~ended.final.walls]]
    if ended.scene is not None:
        shown.append(ended.scene.walls.reshape(-1, 2))
    elif ended.grid is not None:
        known = np.argwhere(ended.grid.occupancy() == 100)[:, ::-1]
        shown.append(known * ended.config.grid.cell_m + np.array(ended.grid.origin))
    points = np.concatenate(shown)
    slack = 0.5 + 0.01 * np.ptp(points, axis=0).max()
    return points.min(axis=0) - slack, points.max(axis=0) + slack


def _height(artist: Any) -> float:
    """Where an artist is in the order of drawing."""
    return float(artist.get_zorder())


def _even(height_in: float) -> float:
    """A height of an even number of pixels, which H.264 asks for."""
    return 2.0 * round(0.5 * height_in * _DPI) / _DPI


class _Writer(Protocol):
    """Takes (H, W, 3) frames, bytes, one after the other."""

    def add(self, frame: Frame) -> None: ...

    def close(self) -> None: ...


class _Mp4:
    """Frames through ffmpeg; the file appears when all of them are there."""

    def __init__(self, file: Path) -> None:
        self._file, self._partial = file, file.with_name(f".{file.name}.partial.mp4")
        self._ffmpeg: subprocess.Popen[bytes] | None = None
        self._last = b""

    def add(self, frame: Frame) -> None:
        if self._ffmpeg is None:
            height, width, _ = frame.shape
            raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{1000 / _FRAME_MS:g}"]
            # The pixel format and the place of the index that browsers and phones ask for.
            out = ["-c:v", "h264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(self._partial)]
            words = ["ffmpeg", "-v", "error", "-y", *raw, "-i", "-", *out]
            nowhere = subprocess.DEVNULL
            self._ffmpeg = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere)
        self._last = frame.tobytes()
        self._write()

    def close(self) -> None:
        for _ in range(_HELD):
            self._write()
        assert self._ffmpeg is not None
        try:
            self._ffmpeg.communicate()
        except OSError:
            self._fail()
        if self._ffmpeg.returncode != 0:
            self._fail()
        self._partial.replace(self._file)

    def _write(self) -> None:
        assert self._ffmpeg is not None and self._ffmpeg.stdin is not None
        try:
            self._ffmpeg.stdin.write(self._last)
        except OSError:  # ffmpeg has gone
            self._fail()

    def _fail(self) -> None:
        self._partial.unlink(missing_ok=True)
        raise AnimationError(f"--animate: ffmpeg cannot write {self._file}, allowed: FILE.gif") from None


class _Gif:
    """Frames in few colours."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._frames: list[Any] = []

    def add(self, frame: Frame) -> None:
        from PIL import Image

        image = Image.fromarray(frame)
        self._frames.append(image.quantize(_GIF_COLORS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE))

    def close(self) -> None:
        first, *rest = self._frames
        durations = [_FRAME_MS] * len(rest) + [_HELD * _FRAME_MS]
        first.save(self._file, save_all=True, append_images=rest, duration=durations, loop=0)
