"""Ctrl-C that waits for the end of a tick, so that a run ends in order with everything written."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

AGAIN_S = 2.0

_last_s = -math.inf  # when one was noted, whichever run it ended


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Within the block the first Ctrl-C is only noted, and the function given tells of it; a second one raises.

    So does one within two seconds of the first in a later block: whoever presses twice means the loop over many runs.
    Outside the main thread signals cannot be caught, and the function says no.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    asked = False

    def note(number: int, frame: Any) -> None:
        nonlocal asked
        global _last_s
        now_s = time.monotonic()
        if asked or now_s - _last_s < AGAIN_S:
            _last_s = -math.inf
            raise KeyboardInterrupt
        asked, _last_s = True, now_s

    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, before)
