import os
import signal
import threading

import pytest

from sixthsense.config import preset
from sixthsense.interrupt import deferred_interrupt
from sixthsense.loop import run


def test_an_interrupted_run_ends_in_order_with_what_it_has():
    def press(tick, trace):
        if len(trace.stamps_ns) == 20:
            os.kill(os.getpid(), signal.SIGINT)

    trace = run(preset(task="tour", max_time=100.0), press)
    assert trace.outcome == "interrupted" and len(trace.stamps_ns) == 20
    assert trace.metrics()["ate_rmse_m"] < 0.05 and len(trace.trajectory) == len(trace.key_stamps_ns)


def test_the_handler_of_before_is_back_afterwards_and_a_second_press_is_not_held_back():
    before = signal.getsignal(signal.SIGINT)
    with deferred_interrupt() as interrupted:
        assert not interrupted()
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            signal.pthread_sigmask(signal.SIG_BLOCK, [])  # a place where Python looks for signals
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_runs_without_a_handler():
    said = []

    def inside():
        with deferred_interrupt() as interrupted:
            said.append(interrupted())

    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert said == [False]
