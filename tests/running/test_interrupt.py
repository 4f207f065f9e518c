import math
import os
import signal
import subprocess
import sys
import threading

import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.core.source import Tick
from sixthsense.logs.log import Log
from sixthsense.loop import interrupt
from sixthsense.loop.interrupt import deferred_interrupt
from sixthsense.loop.run import replay


@pytest.fixture(autouse=True)
def _nothing_pressed_before(monkeypatch):
    monkeypatch.setattr(interrupt._signals, "ctrl_c_s", -math.inf)


def press(*_):
    os.kill(os.getpid(), signal.SIGINT)
    signal.pthread_sigmask(signal.SIG_BLOCK, [])  # a place where Python looks for signals


def test_the_previous_handler_is_restored_and_a_second_press_is_not_deferred():
    before = signal.getsignal(signal.SIGINT)
    with deferred_interrupt() as interrupted:
        assert not interrupted()
        press()
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            press()
    assert signal.getsignal(signal.SIGINT) is before


def test_a_signal_is_the_main_threads_alone():
    defers, is_pressed, seen = threading.Event(), threading.Event(), []

    def run_elsewhere():
        with deferred_interrupt() as interrupted:
            defers.set()
            is_pressed.wait(5.0)
            seen.append(interrupted())

    elsewhere = threading.Thread(target=run_elsewhere)
    with interrupt.handled(signal.SIGINT):
        elsewhere.start()
        assert defers.wait(5.0)
        with pytest.raises(KeyboardInterrupt):
            press()
        is_pressed.set()
        elsewhere.join()
    assert seen == [False]


def test_a_run_that_is_interrupted_before_its_first_scan_is_none():
    ticks = [Tick(1_000_000 * k, Pose(0.1 * k, 0.2, 0.3)) for k in range(3)]
    with pytest.raises(KeyboardInterrupt):
        replay(Log(ticks), preset(), on_tick=press)


def test_pressing_twice_ends_a_loop_over_runs_though_the_first_press_ended_a_run():
    with deferred_interrupt() as interrupted:
        press()
        assert interrupted()
    with deferred_interrupt(), pytest.raises(KeyboardInterrupt):
        press()


SWALLOWING = """
import os, signal, time, weakref
from sixthsense.loop.interrupt import command_signals

class Kept:
    pass

def stop(_):
    os.kill(os.getpid(), signal.SIGHUP)
    time.sleep(0.01)

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it
with command_signals() as signals:
    try:
        kept = Kept()
        callback = weakref.ref(kept, stop)
        del kept
        time.sleep(20)
    except KeyboardInterrupt:
        print("interrupted by", signals.number)
"""


def test_an_interrupt_that_python_drops_in_a_finalizer_comes_again():
    done = subprocess.run([sys.executable, "-c", SWALLOWING], capture_output=True, text=True, timeout=15)
    assert done.stdout == f"interrupted by {signal.SIGHUP.value}\n" and done.stderr == ""


COMPILING = """
import os, signal, threading, time
import numba
from numba.core.compiler_lock import global_compiler_lock
from sixthsense.loop import interrupt

raised_inside, ended = [], 0
handle = interrupt.Signals.handle

def watched(self, number, frame):
    was_compiling = global_compiler_lock.is_locked()
    try:
        handle(self, number, frame)
    except KeyboardInterrupt:
        raised_inside.append(was_compiling)
        raise

interrupt.Signals.handle = watched
for turn in range(15):
    kernel = numba.njit(lambda x, turn=turn: x * turn + sum([x, x]))
    pressing = threading.Timer(0.01 * turn, lambda: [os.kill(os.getpid(), signal.SIGINT) for _ in range(2)])
    try:
        with interrupt.command_signals():
            pressing.start()
            kernel(float(turn))
            time.sleep(30)
    except KeyboardInterrupt:
        ended += 1
    time.sleep(0.06)
print(ended, any(raised_inside))
"""


def test_no_handler_raises_while_numba_compiles():
    """Compilations of some 0.1 s, with two Ctrl-C within each or a little later, which end the wait after it."""
    done = subprocess.run([sys.executable, "-c", COMPILING], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (0, "15 False\n"), done.stderr
