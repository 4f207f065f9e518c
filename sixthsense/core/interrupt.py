"""Signals that end a run: they take effect at the end of a tick, so that a run ends in order with all files written.

Ctrl-C is SIGINT. A command also ends by SIGTERM (kill, batch systems) and SIGHUP (a closed terminal).
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

AGAIN_S = 2.0
"""A second Ctrl-C within this time of the first raises, in a later block too."""

_RESENT_S = 0.05

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

_last_s = -math.inf  # time of the last deferred interrupt of any block
_command: CommandSignals | None = None  # of the command that is running


class CommandSignals:
    """The signals that a command has received: which was the first, and whether one is to interrupt it."""

    def __init__(self) -> None:
        self.number = 0
        """the first signal, 0 before it"""
        self.taken: tuple[int, ...] = ()
        """signals that the command handles; one that is ignored, as SIGHUP is under nohup, stays so"""
        self.is_over = False
        """whether nothing is left to interrupt"""
        self.is_last = False
        """whether the process ends with the command: later signals are ignored"""
        self._presses_s: list[float] = []
        self._is_swallowed = False
        self._report = sys.unraisablehook

    def note(self, number: int) -> bool:
        """Note a signal and return whether it interrupts: SIGTERM and SIGHUP, which may be sent twice, do so once.

        The third Ctrl-C within two seconds ends the process at once.
        """
        is_first, self.number = self.number == 0 or self._is_swallowed, self.number or number
        self._is_swallowed = False
        if number == signal.SIGINT:
            self._presses_s = [*self._presses_s[-2:], time.monotonic()]
            if len(self._presses_s) == 3 and self._presses_s[-1] - self._presses_s[0] < AGAIN_S:
                os._exit(128 + number)
        return not self.is_over and (is_first or number == signal.SIGINT)

    def swallowed(self) -> None:
        """Take in that the interrupt was raised where Python drops exceptions, and send the signal again soon.

        It drops them in finalizers and in callbacks of weak references, which run anywhere.
        """
        self._is_swallowed, self._presses_s = True, self._presses_s[:-1]
        again = threading.Timer(_RESENT_S, os.kill, (os.getpid(), self.number))
        again.daemon = True
        again.start()

    def dropped(self, unraisable: Any) -> None:
        """Take in what Python has dropped, in place of its own hook, which tells of everything before a signal.

        After one, objects whose construction was interrupted cannot be finalized: nothing is lost with them.
        """
        if not self.number:
            self._report(unraisable)
        elif issubclass(unraisable.exc_type, KeyboardInterrupt) and not self.is_over:
            self.swallowed()

    def interrupt(self, frame: Any) -> None:
        """Raise KeyboardInterrupt in a handler of a signal, or later where it would be dropped, too."""
        while frame is not None:
            if frame.f_code is CommandSignals.dropped.__code__:
                self.swallowed()
                return
            frame = frame.f_back
        raise KeyboardInterrupt

    def exit_code(self, code: int) -> int:
        """The exit code of a command that ends with `code`: 128 plus the signal that ended it, if one has."""
        ended_by_other = self.number not in (0, signal.SIGINT)
        return 128 + self.number if ended_by_other else code


@contextmanager
def command_signals() -> Iterator[CommandSignals]:
    """Within the block SIGTERM and SIGHUP interrupt as Ctrl-C does: they raise KeyboardInterrupt, or are deferred.

    For commands, which own their process. Outside the main thread, and within another such block, nothing changes.
    """
    global _command
    command = CommandSignals()
    if _command is not None or threading.current_thread() is not threading.main_thread():
        yield command
        return

    def interrupt(number: int, frame: Any) -> None:
        if command.note(number):
            command.interrupt(frame)

    report, sys.unraisablehook = sys.unraisablehook, command.dropped

    command.taken = tuple(n for n in ENDING if signal.getsignal(n) not in (signal.SIG_IGN, None))
    before = {number: signal.signal(number, interrupt) for number in command.taken}
    _command = command
    try:
        yield command
    finally:
        _command, sys.unraisablehook = None, report
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if command.is_last else handler)


def is_command_ended() -> bool:
    """Whether the command that is running has received a signal, if only after the end of its run."""
    return _command is not None and _command.number != 0


def is_ended_by_ctrl_c() -> bool:
    """Whether the signal that ends a run is Ctrl-C: the only one outside of a command."""
    return _command is None or _command.number == signal.SIGINT


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Defer the first Ctrl-C in the block; the yielded function tells whether there was one. A second one raises.

    One in a later block also raises if it follows the first within two seconds: pressing twice ends a loop over many
    runs. SIGTERM and SIGHUP to a command are deferred however often they come. Outside the main thread signals cannot
    be caught, and the function always returns False.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    asked = False

    def note(number: int, frame: Any) -> None:
        nonlocal asked
        global _last_s
        if _command is not None:
            _command.note(number)
        if number != signal.SIGINT:
            asked = True
            return
        now_s = time.monotonic()
        if asked or now_s - _last_s < AGAIN_S:
            _last_s = -math.inf
            if _command is not None:
                _command.interrupt(frame)
                return
            raise KeyboardInterrupt
        asked, _last_s = True, now_s

    numbers = {signal.SIGINT, *(() if _command is None else _command.taken)}
    before = {number: signal.signal(number, note) for number in numbers}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def terminal_blocked() -> Iterator[None]:
    """Block SIGINT and SIGHUP within the block; processes and threads that are started in it inherit the mask.

    A terminal sends them to all processes of the group, and only the one that has started the others may end them.
    """
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    from multiprocessing import resource_tracker  # here, since most commands start no process

    resource_tracker.ensure_running()  # starting it with the first process would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
