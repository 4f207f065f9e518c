"""Signals to a command: a run ends in order, nothing is left behind."""

import json
import signal
import time
from pathlib import Path

import pytest
from processes import start, wait_until

import sixthsense as ss
from sixthsense.record.folder import has_record, reason_not_a_run

pytestmark = pytest.mark.usefixtures("compiled", "here")

ENDLESS = ("run", "rectangle", "--task", "tour", "--max-time", "1e6", "--out", "x")


def outcome(folder: Path) -> str:
    assert reason_not_a_run(folder) == ""
    return str(json.loads((folder / "metrics.json").read_text())["outcome"])


def test_ctrl_c_ends_a_run_with_its_record_and_130(here):
    process = start(*ENDLESS)
    wait_until(lambda: has_record(here / "x.partial"))
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and err == ""
    assert out.endswith("written to x/\n")
    assert outcome(here / "x") == "interrupted" and [path.name for path in here.iterdir()] == ["x"]


@pytest.mark.parametrize("raised", ["KeyboardInterrupt", "Exception('of a library, in its place')"])
@pytest.mark.parametrize("step", ["sixthsense.record.folder.save_config", "sixthsense.running.warmup.prepare"])
def test_a_signal_before_the_first_tick_leaves_nothing(here, step, raised):
    module, name = step.rsplit(".", 1)
    program = f"""import os, signal, {module} as module; real = module.{name}
def stopped(*words):
    real(*words)
    try: os.kill(os.getpid(), signal.SIGTERM)
    except KeyboardInterrupt: raise {raised} from None
module.{name} = stopped"""
    _, err = (process := start(*ENDLESS, program=program)).communicate(timeout=120)
    assert process.returncode == 143 and err == "sixthsense: interrupted\n"
    assert list(here.iterdir()) == []


def test_three_quick_ctrl_c_end_with_130_and_without_a_traceback(here):
    process = start(*ENDLESS)
    wait_until(lambda: has_record(here / "x.partial"))
    for _ in range(3):
        process.send_signal(signal.SIGINT)
        time.sleep(0.03)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err and "Exception ignored" not in err
    folder = here / "x" if (here / "x").exists() else here / "x.partial"
    assert len(ss.load(folder).trace.estimates) > 0


@pytest.mark.slow
def test_a_terminated_campaign_keeps_its_rows(here):
    pytest.importorskip("pandas")
    words = ("campaign", "rectangle", "--seeds", "0:50", "--task", "tour", "--max-time", "2", "--workers", "1")
    process = start(*words, "--out", "c")
    rows = here / "c" / "rows.jsonl"
    wait_until(lambda: rows.exists() and rows.read_text().count("\n") > 1)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 143 and "Traceback" not in err
    assert "of 50 runs are in c/, the same command makes the missing ones" in err
    assert 2 <= len(ss.load_campaign(here / "c")) < 50
    assert [path.name for path in here.iterdir()] == ["c"]
