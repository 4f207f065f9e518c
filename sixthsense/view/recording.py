"""The hook of the loop that shows a run as it goes, and what becomes of it when the run is over."""

from __future__ import annotations

import math
from pathlib import Path

from sixthsense.core.source import Tick
from sixthsense.record.trace import Trace
from sixthsense.view.drawing import Drawing
from sixthsense.view.viewer import LOOPBACK, Viewer, check_place

_PERIOD_S = 1.0  # between two maps, in the source's time
_SHARE = 0.01  # and no oftener than this part of the time so far: so a long log grows by its logarithm
_FLUSH_S = 30.0  # a viewer that was closed takes nothing more


class View:
    """Shows a run as it goes: a hook of the loop, for `on_tick`; leave its `with` block when the run is over.

        with ss.View("run.rrd") as view:
            ss.run("apartment", on_tick=view)

    Shown are scan, features, landmarks with 95 % ellipses, walls, the pose and its 95 % ellipse, the grid, frontiers,
    plan, NEES, NIS and the time of each stage, over the source's time and over the number of the scan. A file, .rrd, is
    opened with `rerun FILE`.
    """

    def __init__(self, place: str | Path = "window", address: str = LOOPBACK) -> None:
        """Show it at a `place`: "window", "browser" or a file, .rrd, which is overwritten.

        A browser's server is bound to `address`, the loopback by default: whoever reaches it can look on, so choose
        another in a network you trust. Usage statistics are off. Raises ViewError for a place that is none, where Rerun
        is not installed, and where there is no display for a window.
        """
        check_place(place, address)
        self._viewer: Viewer | None = None
        if str(place) == "window":
            self._viewer = Viewer("window")
        elif str(place) == "browser":
            self._viewer = Viewer("browser", address)
        self._drawing = Drawing(place if self._viewer is None else self._viewer.stream)
        self.page = "" if self._viewer is None else self._viewer.page
        """what a browser opens to see it; empty of a window and of a file"""
        self._trace: Trace | None = None
        self._scans = self._keys = self._plans = 0
        self._next_s = -math.inf  # when the map is sent again
        self._is_open = True

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Show what a tick has brought, if it has brought a scan."""
        if self._trace is not trace:
            self._trace, self._scans, self._keys, self._plans, self._next_s = trace, 0, 0, 0, -math.inf
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
            self._next_s = now_s + max(_PERIOD_S, _SHARE * now_s)
            self._drawing.map(trace)

    def finish(self) -> None:
        """Show the end of the run, and send all that is still to be sent."""
        if self._trace is not None and self._trace.stamps_ns:
            self._drawing.map(self._trace)
        self._drawing.flush(_FLUSH_S)

    @property
    def is_interrupted(self) -> bool:
        """Whether the run was ended by Ctrl-C."""
        return self._trace is not None and self._trace.outcome == "interrupted"

    def wait(self) -> None:
        """Keep a browser's server until Ctrl-C; returns at once of a window and of a file."""
        if self.page and self._viewer is not None:
            self._viewer.wait()

    def close(self) -> None:
        """End it; a window stays until its user closes it."""
        if not self._is_open:
            return
        self._is_open = False
        self.finish()
        self._drawing.close()
        if self.page and self._viewer is not None:
            self._viewer.end()
