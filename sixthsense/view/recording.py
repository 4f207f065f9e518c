"""`View`: the hook of the loop that shows a run live, and its end."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

from sixthsense.core.source import Tick
from sixthsense.record.trace import Trace
from sixthsense.slam.mapping.changes import Revision
from sixthsense.view import LOOPBACK
from sixthsense.view.drawing import Drawing
from sixthsense.view.viewer import Viewer, check_view_target

_PERIOD_S = 1.0  # shortest period of the map, in the source's time
_PERIOD_SHARE = 0.01  # the period is also at least this share of the time so far: the file grows logarithmically
_FLUSH_S = 30.0  # timeout, since a closed viewer accepts no data


class View:
    """Shows a run live: a hook of the loop, for `on_tick`; leave its `with` block when the run is over.

        with ss.View("run.rrd") as view:
            ss.run("apartment", on_tick=view)

    The view has scan, features, landmarks with 95 % ellipses, walls, the pose with its 95 % ellipse, grid, frontiers,
    plan, NEES, NIS and the time of each stage, over the source's time and over the scan number. Open an .rrd file with
    `rerun FILE`.
    """

    def __init__(self, place: str | Path = "window", address: str = LOOPBACK) -> None:
        """Show the run at a `place`: "window", "browser" or an .rrd file, which is overwritten.

        Stream and page are served at `address`, by default the loopback. Everybody who can reach it can watch and send,
        so choose another one only in a trusted network. Usage statistics are off. Raises InputError for an unknown
        place, without Rerun, and for a window without a display.
        """
        check_view_target(place, address)
        self._viewer = Viewer(str(place), address) if str(place) in ("window", "browser") else None
        self.page = "" if self._viewer is None else self._viewer.page
        """address of the page for a browser; empty for a window or a file"""
        self._open = contextlib.ExitStack()
        if self._viewer is not None:
            self._open.callback(self._viewer.end if self.page else self._viewer.leave)
        self._drawing = Drawing(place if self._viewer is None else self._viewer.stream)
        self._open.callback(self._drawing.close)
        self._open.callback(self.finish)
        self._trace: Trace | None = None
        self._scans = self._keys = self._plans = 0
        self._next_s = -math.inf  # time of the next map
        self._revision: Revision | None = None  # of the grid sent last

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Show the data of a tick that has a scan."""
        if self._trace is not trace:
            self._trace, self._scans, self._keys, self._plans = trace, 0, 0, 0
            self._next_s, self._revision = -math.inf, None
            self._drawing.begin(trace)
        if len(trace.stamps_ns) == self._scans:
            return
        self._scans = len(trace.stamps_ns)
        now_s = 1e-9 * (tick.stamp_ns - trace.stamps_ns[0])
        self._drawing.set_time(now_s, self._scans - 1)
        self._drawing.robot(tick, trace)
        if len(trace.key_stamps_ns) > self._keys:
            self._keys = len(trace.key_stamps_ns)
            self._drawing.features(trace)
            self._drawing.plots(trace)
        if len(trace.plans) > self._plans:
            self._plans = len(trace.plans)
            self._drawing.plan(trace.plans[-1])
        if now_s >= self._next_s:
            self._next_s = now_s + max(_PERIOD_S, _PERIOD_SHARE * now_s)
            self._show_map(trace)

    def finish(self) -> None:
        """Send the final map and all pending data."""
        if self._trace is not None and self._trace.stamps_ns:
            self._show_map(self._trace)
        self._drawing.flush(_FLUSH_S)

    def _show_map(self, trace: Trace) -> None:
        grid = trace.draw_map()
        revision = None if grid is None else grid.changes.revision
        self._drawing.map(trace, revision != self._revision)
        self._revision = revision

    def wait(self) -> None:
        """Keep the server for browsers until Ctrl-C; return at once for a window or a file."""
        if self.page and self._viewer is not None:
            self._viewer.wait()

    def close(self) -> None:
        """End the view; a window stays open until the user closes it."""
        self._open.close()
