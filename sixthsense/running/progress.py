"""A progress bar of the source's time, for terminals and notebooks."""

from __future__ import annotations

import contextlib
import os
import time
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sixthsense.core.source import Tick
    from sixthsense.loop.run import OnTick
    from sixthsense.record.trace import Trace

_BAR_FORMAT = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f} of {total:.0f} s{postfix}, {elapsed} so far, {remaining} left"
_ENDLESS_FORMAT = "{desc}: {n:.0f} s{postfix}, {elapsed} so far"


@contextlib.contextmanager
def progress(
    label: str, total_s: float | None, shown: bool | None = None, status: Callable[[Trace], str] | None = None
) -> Iterator[tuple[OnTick, Callable[[str], object]]]:
    """A bar for `total_s` seconds of the source, or without an end for None: a hook that moves it, and one for texts.

    `shown` is by default whether the output is interactive. `status` is shown beside the bar, anew every second. One
    that reads the map is for runs that read it at every keyframe anyway: a replay would draw it for the bar alone.
    """
    bar_format, period_s = _ENDLESS_FORMAT if total_s is None else _BAR_FORMAT, 0.1 if status is None else 1.0
    bar = progress_bar(
        shown, total=total_s, desc=label, leave=False, bar_format=bar_format, mininterval=period_s, miniters=0
    )
    first_ns: int | None = None

    def draw(change: Callable[[], object]) -> None:
        """Draw on the terminal; one that has been closed ends the bar and not the run."""
        try:
            change()
        except OSError:
            bar.disable = True

    def move(now_s: float, trace: Trace) -> None:
        if bar.update(now_s - bar.n) and status is not None:
            bar.set_postfix_str(status(trace))

    def advance(tick: Tick, trace: Trace) -> None:
        nonlocal first_ns
        first_ns = tick.stamp_ns if first_ns is None else first_ns
        now_s = 1e-9 * (tick.stamp_ns - first_ns)
        draw(lambda: move(now_s, trace))

    def say(text: str) -> None:
        draw(lambda: bar.set_description_str(f"{label}: {text}" if text else label))

    try:
        yield advance, say
    finally:
        draw(bar.close)


def paced() -> OnTick:
    """A hook of the loop that slows the source down to real time."""
    first: tuple[int, float] | None = None

    def wait(tick: Tick, trace: Trace) -> None:
        nonlocal first
        first = first or (tick.stamp_ns, time.monotonic())
        time.sleep(max(0.0, first[1] + 1e-9 * (tick.stamp_ns - first[0]) - time.monotonic()))

    return wait


def seen_area(trace: Trace) -> str:
    """How much an exploration has seen, which has no other measure of its end; empty before the first scan."""
    grid = trace.draw_map()
    return "" if grid is None or grid.seen_area_m2 == 0.0 else f"{grid.seen_area_m2:.0f} m² seen"


def progress_bar(shown: bool | None, **options: Any) -> Any:
    """A bar of tqdm for a terminal or notebook, or a disabled one that writes nothing; None: where someone sees it.

    TQDM_DISABLE=1 in the environment hides all bars.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without ipywidgets tqdm warns and falls back to text
        from tqdm.auto import tqdm

    is_hidden = shown is False or os.environ.get("TQDM_DISABLE", "") not in ("", "0")  # notebook bars ignore it
    return tqdm(disable=True if is_hidden else None if shown is None else False, **options)
