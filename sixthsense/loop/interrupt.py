"""Signals that end a run in order: within a block that defers them the first one only sets a flag.

Ctrl-C is SIGINT. A command also ends by SIGTERM (kill, batch systems) and SIGHUP (a closed terminal).
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

AGAIN_S = 2.0
"""a second Ctrl-C within this time of the first raises, in a later block too"""

_RESENT_S = 0.05


class Signals:
    """The signals that a command, or a block outside of commands, has received."""

    def __init__(self) -> None:
        self.number, self.ctrl_c_s = 0, -math.inf
        """the first signal, 0 before it; time of the last Ctrl-C"""
        self.is_deferred = self.is_over = self.is_last = self.has_raised = False
        """whether the first signal only sets `number`; nothing is left to interrupt; the process ends with the block;
        KeyboardInterrupt was raised, of which a library may make an error of its own"""

    def handle(self, number: int, frame: Any) -> None:
        """Note a signal; raise KeyboardInterrupt for a second Ctrl-C, and for a first signal that is not deferred."""
        is_first, last_s = self.number == 0, self.ctrl_c_s
        self.number = self.number or number
        if number == signal.SIGINT:
            self.ctrl_c_s = time.monotonic()
        is_again = number == signal.SIGINT and (not is_first or self.ctrl_c_s - last_s < AGAIN_S)
        if self.is_over or not (is_again or (is_first and not self.is_deferred)):
            return
        if not _is_compiling():
            self.has_raised = True
            raise KeyboardInterrupt
        if not self.is_deferred:  # else the run ends after the compilation
            self.send_again(number)

    def send_again(self, number: int) -> None:
        """Deliver a signal to this process again, a moment later."""
        self.number, self.ctrl_c_s = 0, -math.inf
        again = threading.Timer(_RESENT_S, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()

    def exit_code(self, code: int) -> int:
        """The exit code of a command that ends with `code`: 128 plus the signal that ended it, if one has."""
        return code if self.number in (0, signal.SIGINT) else 128 + self.number


_signals = Signals()


def _is_compiling() -> bool:
    """Whether this thread is within a compilation of Numba; LLVM may not survive an exception in its callbacks."""
    lock = sys.modules.get("numba.core.compiler_lock")
    return lock is not None and bool(lock.global_compiler_lock.is_locked())


@contextlib.contextmanager
def handled(*numbers: int) -> Iterator[Signals]:
    """Handle the signals of these numbers in the block, but for those that are ignored, as SIGHUP is under nohup.

    In a block within nothing changes. In another thread than the main one, which alone receives signals, none come.
    """
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) == _signals.handle:
        yield _signals if is_main else Signals()
        return

    def dropped(unraisable: Any) -> None:
        """Send an interrupt again that was raised in a finalizer, and do not report what it has left half made."""
        if not _signals.number:
            report(unraisable)
        elif issubclass(unraisable.exc_type, KeyboardInterrupt):
            _signals.send_again(_signals.number)

    taken = [number for number in numbers if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    before = {number: signal.signal(number, _signals.handle) for number in taken}
    report, sys.unraisablehook = sys.unraisablehook, dropped
    try:
        yield _signals
    finally:
        if not _signals.is_last:
            sys.unraisablehook, _signals.number, _signals.is_over, _signals.has_raised = report, 0, False, False
        for number, handler in before.items():  # Python gives up its handlers before a process has ended
            signal.signal(number, signal.SIG_IGN if _signals.is_last else handler)


def command_signals() -> contextlib.AbstractContextManager[Signals]:
    """Handle Ctrl-C, SIGTERM and SIGHUP in the block, which is a command."""
    return handled(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextlib.contextmanager
def deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Defer the first signal in the block; the yielded function returns whether there was one. A second Ctrl-C raises.

    So does one in a later block within two seconds: pressing twice ends a loop over many runs. Outside of commands the
    only signal is Ctrl-C.
    """
    with handled(signal.SIGINT) as signals:
        before, signals.is_deferred = signals.is_deferred, True
        try:
            yield lambda: signals.number != 0
        finally:
            signals.is_deferred = before


def is_command_ended() -> bool:
    """Whether the command that is running has received a signal, if only after the end of its run."""
    return _signals.number != 0


def is_ended_by_ctrl_c() -> bool:
    """Whether the signal that ends a run is Ctrl-C: the only one outside of a command."""
    return _signals.number in (0, signal.SIGINT)


@contextlib.contextmanager
def terminal_blocked() -> Iterator[None]:
    """Block SIGINT and SIGHUP within the block; processes and threads that are started in it inherit the mask.

    A terminal sends them to all processes of the group, and only the one that has started the others may end them.
    """
    from multiprocessing import resource_tracker  # here, since most commands start no process

    resource_tracker.ensure_running()  # starting it with the first process would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
