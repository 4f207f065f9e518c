"""A progress bar over a source's time, in terminals and notebooks."""

from __future__ import annotations

import os
import sys
import time
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sixthsense.core.source import Tick
    from sixthsense.loop import OnTick
    from sixthsense.record.trace import Trace

_FORM = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f} of {total:.0f} s{postfix}, {elapsed} so far"


def each(*hooks: OnTick) -> OnTick:
    """One hook for the loop that calls several."""

    def call(tick: Tick, trace: Trace) -> None:
        for hook in hooks:
            hook(tick, trace)

    return call


def in_notebook() -> bool:
    """Whether Jupyter's kernel runs this."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell is not None and "IPKernelApp" in shell.config


def is_interactive() -> bool:
    """Whether somebody looks on: in a notebook, or at a terminal."""
    return in_notebook() or sys.stderr.isatty()


class Progress:
    """Shows how much of a run's time is over, and of an exploration how much it has seen.

    A hook of the loop; with `realtime` it also holds the source's clock back to the wall's.
    """

    def __init__(self, label: str, total_s: float, realtime: bool = False, shown: bool | None = None) -> None:
        """Make a bar of `total_s` seconds of the source; `shown` by default where somebody looks on.

        TQDM_DISABLE=1 in the environment hides all.
        """
        self._label = label
        self._total_s = total_s
        self._realtime = realtime
        hidden = os.environ.get("TQDM_DISABLE", "") not in ("", "0")  # which tqdm's notebook bars do not heed
        self._is_shown = (is_interactive() if shown is None else shown) and not hidden
        self._first_ns: int | None = None
        self._shown_s = 0.0
        self._began = 0.0
        self._seen_at = 0.0

    def __enter__(self) -> Progress:
        self._bar = _bar(self._is_shown, total=self._total_s, desc=self._label, leave=False, bar_format=_FORM)
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def say(self, text: str) -> None:
        """Show a word beside the bar."""
        self._bar.set_description_str(f"{self._label}: {text}" if text else self._label)

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Move on to a tick's time."""
        now = time.monotonic()
        if self._first_ns is None:
            self._first_ns, self._began = tick.stamp_ns, now
        now_s = 1e-9 * (tick.stamp_ns - self._first_ns)
        if now_s - self._shown_s >= 0.1:
            if self._is_shown and now - self._seen_at >= 1.0 and trace.grid is not None:
                self._seen_at = now
                area = float(trace.grid.seen.sum()) * trace.config.grid.cell_m**2
                self._bar.set_postfix_str(f"{area:.0f} m² seen" if area else "", refresh=False)
            self._bar.update(now_s - self._shown_s)
            self._shown_s = now_s
        if self._realtime:
            time.sleep(max(0.0, self._began + now_s - time.monotonic()))


def _bar(shown: bool, **options: Any) -> Any:
    """A bar for where this runs; what is not shown writes nothing."""
    if not shown:
        from tqdm import tqdm

        return tqdm(disable=True, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without ipywidgets the bar is text, which needs no warning
        from tqdm.auto import tqdm as auto

    return auto(**options)
