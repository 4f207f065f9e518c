"""The live view's entities of a run in Rerun.

All entities in the plane are below `map`, which mirrors the world in y because y points down in Rerun's 2-D views. Data
is in metres, world frame, except for the body below `map/robot`, which is in the robot frame.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick
from sixthsense.evaluation import metrics
from sixthsense.figures import plot
from sixthsense.record.trace import Trace

_FREE, _OBSTACLE = 1, 2  # classes of the grid's cells; 0 is unseen
_THIN, _THICK = 1.0, 2.0  # of lines, pixels
_CIRCLE = np.linspace(0.0, 2.0 * math.pi, 33)
_FILE_TICK = timedelta(seconds=5.0)  # wall time between two writes to a file
_BAND = "#999999"


class Drawing:
    """A Rerun recording stream and the entities sent to it."""

    def __init__(self, sink: str | Path) -> None:
        """Open a stream to a file, or to the viewer at an address, rerun+http://..."""
        import rerun

        self._rr = rerun
        is_live = str(sink).startswith("rerun+http://")
        batches = rerun.ChunkBatcherConfig.DEFAULT()
        if not is_live:
            batches.flush_tick = _FILE_TICK  # fewer and larger chunks load faster
        self._stream = rerun.RecordingStream("sixthsense", batcher_config=batches)
        self._stream.set_log_time_enabled(False)
        if is_live:
            self._stream.connect_grpc(str(sink))
        else:
            Path(sink).parent.mkdir(parents=True, exist_ok=True)
            with Path(sink).open("wb"):  # whose error names the file
                self._stream.save(sink)

    def begin(self, trace: Trace) -> None:
        """Send the static entities: layout, true walls, colours and names."""
        rr, scene = self._rr, trace.scene
        self._stream.send_blueprint(self._blueprint(trace))
        self._stream.log("map", rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
        free, obstacle = _rgb(plot.SEEN), _rgb(plot.OBSERVATION)
        names = [(0, "unseen", (0, 0, 0, 0)), (_FREE, "free", free), (_OBSTACLE, "obstacle", obstacle)]
        self._stream.log("map/grid", rr.AnnotationContext(names), static=True)
        if scene is not None:
            self._lines("map/true/walls", scene.walls, plot.WALL, _THICK, static=True)
        circle = trace.radius_m * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
        body = [circle, np.array([[0.0, 0.0], [trace.radius_m, 0.0]])]
        self._lines("map/robot/body", body, plot.TRUTH, _THICK, static=True)
        self._series("plots/nees/pose", "NEES", plot.ESTIMATE)
        self._series("plots/nis/per_dof", "NIS per degree of freedom", plot.ESTIMATE)
        for kind in ("nees", "nis"):
            for end in ("low", "high"):
                self._series(f"plots/{kind}/{end}", f"95 % band, {end}", _BAND)

    def set_time(self, now_s: float, scan: int) -> None:
        """Set the source's time and the scan number of the following data."""
        self._stream.set_time("time", duration=now_s)
        self._stream.set_time("scan", sequence=scan)

    def robot(self, tick: Tick, trace: Trace) -> None:
        """Send the estimated pose, the true position and the scan."""
        rr, live = self._rr, trace.live
        pose = Pose.from_array(trace.estimates[-1])
        turn = rr.RotationAxisAngle(axis=[0.0, 0.0, 1.0], radians=pose.theta)
        self._stream.log("map/robot", rr.Transform3D(translation=[pose.x, pose.y, 0.0], rotation=turn))
        if live is not None and live.scan is not None:
            self._points("map/scan", pose @ live.scan.returns_robot, plot.ODOMETRY, 1.5)
        if tick.truth is not None:
            self._points("map/true/robot", tick.truth.position[None], plot.TRUTH, 4.0)
        if tick.walkers is not None:
            self._lines("map/true/walkers", plot.walker_outlines(tick.walkers), plot.WALKER, _THICK)

    def features(self, trace: Trace) -> None:
        """Send the features of the last keyframe and the 95 % plot.ellipse of the pose after it."""
        estimate, live = trace.key_estimates[-1], trace.live
        outline = plot.ellipse(estimate.pose.position, estimate.pose_cov[:2, :2])
        self._lines("map/pose", [outline], plot.ESTIMATE, _THICK)
        if live is None or live.features is None:
            return
        points = np.array(
            [observation.z for observation in live.features.observations if not observation.is_wall]
        ).reshape(-1, 2)
        self._lines("map/features/walls", estimate.pose @ live.features.walls, plot.WALL_FOUND, 3.0)
        self._points("map/features/points", estimate.pose @ points, plot.WALL_FOUND, 5.0)

    def plots(self, trace: Trace) -> None:
        """Send NEES, NIS and stage times of the last keyframe."""
        estimate, association = trace.key_estimates[-1], trace.associations[-1]
        cov = estimate.pose_cov[None]
        if trace.key_truths and metrics.full_rank_from(cov) == 0:
            error = (estimate.pose.array() - trace.key_truths[-1])[None]
            self._scalars("plots/nees", float(metrics.nees_world(error, cov)[0]), metrics.nees_band(1), "pose")
        dof = association.dof
        if dof:
            band = float(chi_square_quantile(0.025, dof)) / dof, float(chi_square_quantile(0.975, dof)) / dof
            self._scalars("plots/nis", association.nis / dof, band, "per_dof")
        for stage, ms in trace.stopwatch.rows[-1].items():
            self._stream.log(f"plots/timing/{stage}", self._rr.Scalars(ms))

    def plan(self, path: Array) -> None:
        """Send a planned path (N, 2)."""
        self._lines("map/plan", [path], plot.PLAN, _THICK)

    def map(self, trace: Trace, has_changed: bool = True) -> None:
        """Send the grid and the frontiers, if the grid has changed; the landmarks and the path so far."""
        if has_changed:
            self._grid(trace)
        self._landmarks(trace)
        driven = np.array([estimate.pose.position for estimate in trace.key_estimates]).reshape(-1, 2)
        self._lines("map/driven", [driven], plot.ESTIMATE, _THICK)
        self._doubts(trace)
        if trace.key_truths:
            self._lines("map/true/driven", [np.array(trace.key_truths)[:, :2]], plot.TRUTH, _THIN)

    def flush(self, timeout_s: float) -> None:
        """Wait until all data is sent, or the viewer is gone."""
        with contextlib.suppress(Exception):  # a closed viewer is not a failure of the run
            self._stream.flush(timeout_sec=timeout_s)

    def close(self) -> None:
        """End the stream."""
        self._stream.disconnect()

    def _grid(self, trace: Trace) -> None:
        trace.draw_map()
        if (known := plot.known_blocks(trace)) is None:
            return
        part, (left, _, bottom, _) = known
        image = np.select([part == 100, part == 0], [_OBSTACLE, _FREE], 0).astype(np.uint8)
        cell_m = trace.config.grid.cell_m
        place = self._rr.Transform3D(translation=[left, bottom, 0.0], scale=[cell_m, cell_m, 1.0])
        self._stream.log("map/grid", self._rr.SegmentationImage(image), place)
        if trace.config.task == "explore" and trace.scene is not None:
            self._points("map/frontiers", plot.frontiers(trace), plot.TRUTH, 1.5)

    def _landmarks(self, trace: Trace) -> None:
        points, covs, extents = plot.landmarks_of(trace)
        outlines = [plot.ellipse(mean, cov, 24) for mean, cov in zip(points, covs, strict=True)]
        self._points("map/landmarks/points", points, plot.LANDMARK, 3.0)
        self._lines("map/landmarks/ellipses", outlines, plot.LANDMARK, _THIN)
        self._lines("map/landmarks/walls", extents, plot.LANDMARK, _THICK)

    def _doubts(self, trace: Trace) -> None:
        """Send what speaks against the map, where it is to be seen; without a place of its own beside the robot."""
        verdict = trace.verdict if trace.live is None else trace.live.verdict
        places, labels = np.zeros((0, 2)), []
        if verdict is not None and verdict.level in ("doubtful", "broken"):
            here = np.array(trace.estimates[-1])[:2]
            told = [(cause.places[0] if len(cause.places) else here, cause.sentence) for cause in verdict.causes]
            told = told or [(here, str(verdict))]
            places, labels = np.array([place for place, _ in told]), [words for _, words in told]
        radius = self._rr.Radius.ui_points(8.0)
        self._stream.log("map/doubts", self._rr.Points2D(places, labels=labels, colors=_rgb(plot.DOUBT), radii=radius))

    def _points(self, path: str, points: Array, color: str, size: float) -> None:
        radius = self._rr.Radius.ui_points(size)
        self._stream.log(path, self._rr.Points2D(points.astype(np.float32), colors=_rgb(color), radii=radius))

    def _lines(self, path: str, lines: Sequence[Array] | Array, color: str, width: float, static: bool = False) -> None:
        radius = self._rr.Radius.ui_points(0.5 * width)
        strips = [np.asarray(line, dtype=np.float32) for line in lines]
        self._stream.log(path, self._rr.LineStrips2D(strips, colors=_rgb(color), radii=radius), static=static)

    def _series(self, path: str, name: str, color: str) -> None:
        self._stream.log(path, self._rr.SeriesLines(colors=_rgb(color), names=name), static=True)

    def _scalars(self, where: str, value: float, band: tuple[float, float], name: str) -> None:
        for path, number in ((name, value), ("low", band[0]), ("high", band[1])):
            self._stream.log(f"{where}/{path}", self._rr.Scalars(number))

    def _blueprint(self, trace: Trace) -> Any:
        """The layout: the map, and the plots beside it; below it in a narrow window."""
        import rerun.blueprint as rrb

        bounds = None
        if trace.scene is not None:
            x0, y0, x1, y1 = trace.config.region or trace.scene.region
            bounds = rrb.VisualBounds2D(x_range=[x0 - 0.5, x1 + 0.5], y_range=[-y1 - 0.5, -y0 + 0.5])
        style: dict[str, Any] = {"background": [255, 255, 255], "visual_bounds": bounds}
        plane = rrb.Spatial2DView(origin="/", contents="/map/**", name="map", **style)
        titles = {
            "nees": "Pose NEES, 95 % band",
            "nis": "NIS per degree of freedom, 95 % band",
            "timing": "Time of each stage of a keyframe, ms",
        }
        plots = []
        for kind, title in titles.items():
            legend = rrb.PlotLegend(visible=kind == "timing")
            plots.append(rrb.TimeSeriesView(origin=f"/plots/{kind}", name=title, plot_legend=legend))
        # A grid without a number of columns takes as many as its window has room for.
        layout = rrb.Grid(plane, rrb.Vertical(*plots), column_shares=[3.0, 2.0])
        # Follow the latest data until the user moves the time cursor.
        clock = rrb.TimePanel(timeline="time", state="collapsed", play_state="following")
        return rrb.Blueprint(layout, clock, collapse_panels=True)


def _rgb(color: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue
