"""Ctrl-C that takes effect at the end of a tick, so that a run ends in order with all files written."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

AGAIN_S = 2.0
"""A second Ctrl-C within this time of the first raises, in a later block too."""

_last_s = -math.inf  # time of the last deferred interrupt of any block


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Defer the first Ctrl-C in the block; the yielded function tells whether there was one. A second one raises.

    One in a later block also raises if it follows the first within two seconds: pressing twice ends a loop over many
    runs. Outside the main thread signals cannot be caught, and the function always returns False.
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
