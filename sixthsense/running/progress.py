"""A progress bar of the source's time, for terminals and notebooks."""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from sixthsense.core.source import Tick
    from sixthsense.record.trace import Trace

_BAR_FORMAT = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f} of {total:.0f} s{postfix}, {elapsed} so far, {remaining} left"
_ENDLESS_FORMAT = "{desc}: {n:.0f} s{postfix}, {elapsed} so far"


def in_notebook() -> bool:
    """Whether the code runs in a Jupyter kernel."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell is not None and "IPKernelApp" in shell.config


def is_interactive() -> bool:
    """Whether the output is a notebook or a terminal."""
    return in_notebook() or sys.stderr.isatty()


class Progress:
    """A hook of the loop that shows the elapsed part of a run's time, and a status of the run if asked for.

    With `realtime` it also slows the source down to real time.
    """

    def __init__(
        self,
        label: str,
        total_s: float | None,
        realtime: bool = False,
        shown: bool | None = None,
        status: Callable[[Trace], str] | None = None,
    ) -> None:
        """Make a bar for `total_s` seconds of the source, or without an end for None.

        `shown` is by default whether the output is interactive.
        `status` is shown beside the bar, anew every second. One that reads the map is for runs that read it at every
        keyframe anyway: in a replay it would be drawn for the bar alone.
        """
        self._status = status
        self._label = label
        self._total_s = total_s
        self._realtime = realtime
        self._shown = shown
        self._first_ns: int | None = None
        self._shown_s = 0.0
        self._start = 0.0
        self._status_updated = 0.0

    def __enter__(self) -> Progress:
        bar_format = _ENDLESS_FORMAT if self._total_s is None else _BAR_FORMAT
        self._bar = progress_bar(self._shown, total=self._total_s, desc=self._label, leave=False, bar_format=bar_format)
        return self

    def __exit__(self, *_: object) -> None:
        self._draw(self._bar.close)

    def say(self, text: str) -> None:
        """Show a text beside the bar."""
        self._draw(lambda: self._bar.set_description_str(f"{self._label}: {text}" if text else self._label))

    def _draw(self, draw: Callable[[], object]) -> None:
        """Draw on the terminal; one that has been closed ends the bar and not the run."""
        try:
            draw()
        except OSError:
            self._bar.disable = True

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Advance the bar to a tick's stamp."""
        now, stamp_ns = time.monotonic(), tick.stamp_ns
        if self._first_ns is None:
            self._first_ns, self._start = stamp_ns, now
        now_s = 1e-9 * (stamp_ns - self._first_ns)
        if now_s - self._shown_s >= 0.1:
            if not self._bar.disable and self._status is not None and now - self._status_updated >= 1.0:
                self._status_updated = now
                self._bar.set_postfix_str(self._status(trace), refresh=False)
            self._draw(lambda: self._bar.update(now_s - self._shown_s))
            self._shown_s = now_s
        if self._realtime:
            time.sleep(max(0.0, self._start + now_s - time.monotonic()))


def seen_area(trace: Trace) -> str:
    """How much is seen of the region; empty before the first scan. An exploration has no other measure of its end."""
    grid = trace.draw_map()
    return area_of(trace, 0.0 if grid is None else grid.seen_area_m2)


def area_of(trace: Trace, area_m2: float) -> str:
    """An area that is seen beside that of the region, if that is explored; empty for none."""
    if area_m2 == 0.0:
        return ""
    region = trace.config.region or (trace.scene.region if trace.scene is not None else None)
    if region is None or trace.config.task != "explore":
        return f"{area_m2:.0f} m² seen"
    x0, y0, x1, y1 = region
    return f"{area_m2:.0f} of at most {max(area_m2, (x1 - x0) * (y1 - y0)):.0f} m² seen"


def live_status(dropped: Mapping[str, int], seen_m2: Callable[[], float]) -> Callable[[Trace], str]:
    """The status of a live run: sigmas of the pose, seen area, scans a second since the last call, dropped messages.

    `dropped` has the present numbers of dropped messages by reason; `seen_m2` gives the area of the map.
    """
    before: tuple[float, int] | None = None  # time and number of scans at the last call

    def status(trace: Trace) -> str:
        from sixthsense.live.publishing import pose_covariance

        nonlocal before
        cov = pose_covariance(trace)
        sigma_m, sigma_rad = np.sqrt(np.linalg.eigvalsh(cov[:2, :2])[-1]), np.sqrt(cov[2, 2])
        now, last = (time.monotonic(), len(trace.stamps_ns)), before
        before = now
        parts = (
            f"sigma {sigma_m:.2f} m {np.degrees(sigma_rad):.1f}°",
            area_of(trace, seen_m2()),
            "" if last is None else f"{(now[1] - last[1]) / (now[0] - last[0]):.1f} scans/s",
            f"{sum(dropped.values())} dropped",
        )
        return ", ".join(part for part in parts if part)

    return status


def progress_bar(shown: bool | None, **options: Any) -> Any:
    """A bar of tqdm for a terminal or notebook, or a disabled one that writes nothing; None: where someone sees it.

    TQDM_DISABLE=1 in the environment hides all bars.
    """
    hidden = os.environ.get("TQDM_DISABLE", "") not in ("", "0")  # tqdm's notebook bars ignore it
    if hidden or not (is_interactive() if shown is None else shown):
        from tqdm import tqdm

        return tqdm(disable=True, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without ipywidgets tqdm warns and falls back to text
        from tqdm.auto import tqdm as auto

    return auto(**options)
