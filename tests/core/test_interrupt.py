import math
import os
import signal
import subprocess
import sys
import threading

import pytest

from sixthsense.config import preset
from sixthsense.core import interrupt
from sixthsense.core.interrupt import deferred_interrupt
from sixthsense.evaluation.measure import measure
from sixthsense.loop.run import run


@pytest.fixture(autouse=True)
def _nothing_pressed_before(monkeypatch):
    monkeypatch.setattr(interrupt, "_last_s", -math.inf)


def test_an_interrupted_run_ends_in_order_with_its_results():
    def press(tick, trace):
        if len(trace.stamps_ns) == 20:
            os.kill(os.getpid(), signal.SIGINT)

    trace = run(preset(task="tour", max_time=100.0), press)
    assert trace.outcome == "interrupted" and len(trace.stamps_ns) == 20
    assert measure(trace)["ate_rmse_m"] < 0.05 and len(trace.trajectory) == len(trace.key_stamps_ns)


def test_the_previous_handler_is_restored_and_a_second_press_is_not_deferred():
    before = signal.getsignal(signal.SIGINT)
    with deferred_interrupt() as interrupted:
        assert not interrupted()
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            signal.pthread_sigmask(signal.SIG_BLOCK, [])  # a place where Python looks for signals
    assert signal.getsignal(signal.SIGINT) is before


def press():
    os.kill(os.getpid(), signal.SIGINT)
    signal.pthread_sigmask(signal.SIG_BLOCK, [])  # a place where Python looks for signals


def test_pressing_twice_ends_a_loop_over_runs_though_the_first_press_ended_a_run():
    with deferred_interrupt() as interrupted:
        press()
        assert interrupted()
    with deferred_interrupt() as interrupted:
        with pytest.raises(KeyboardInterrupt):
            press()
        press()  # a third one is a first one again
        assert interrupted()


def test_another_thread_runs_without_a_handler():
    said = []

    def inside():
        with deferred_interrupt() as interrupted:
            said.append(interrupted())

    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert said == [False]


SWALLOWING = """
import os, signal, time, weakref
from sixthsense.core.interrupt import command_signals

class Kept:
    pass

def stop(_):
    os.kill(os.getpid(), signal.{name})
    time.sleep(0.01)

{more}
with command_signals() as signals:
    try:
        kept = Kept()
        callback = weakref.ref(kept, stop)
        del kept
        time.sleep(20)
    except KeyboardInterrupt:
        print("interrupted by", signals.number)
"""


PRESSING = """
from sixthsense.core.interrupt import CommandSignals

swallowed = CommandSignals.swallowed

def pressing(self):
    CommandSignals.swallowed = swallowed
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)
    self.swallowed()

CommandSignals.swallowed = pressing
"""


@pytest.mark.parametrize("more", ["", PRESSING], ids=["alone", "with another while the first is taken in"])
@pytest.mark.parametrize("name", ["SIGTERM"])
def test_an_interrupt_that_python_drops_in_a_finalizer_comes_again(name, more):
    code = SWALLOWING.format(name=name, more=more)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=15)
    assert done.stdout == f"interrupted by {getattr(signal, name).value}\n" and done.stderr == ""


@pytest.mark.parametrize("is_ended", [False, True])
def test_what_cannot_be_finalized_after_a_signal_is_not_told(is_ended, monkeypatch):
    """Before a signal Python tells of it as usual."""
    told = []
    monkeypatch.setattr(sys, "unraisablehook", lambda unraisable: told.append(unraisable.exc_type))

    class HalfMade:
        def __del__(self) -> None:
            self.never_set.close()

    with interrupt.command_signals() as command:
        if is_ended:
            command.note(signal.SIGTERM)
        made = HalfMade()
        del made
    assert told == [] if is_ended else told == [AttributeError]
