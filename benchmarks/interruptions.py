"""Stop commands at random times, by random signals, and check that nothing is lost.

Each time a run, a replay, a live run or a campaign is started, half of them onto an earlier run or campaign, and gets
SIGKILL, SIGTERM, SIGHUP, SIGINT or three SIGINT. The robot of the live runs is a process of its own on the loopback.
Afterwards the earlier run is intact or the new one is whole, what was recorded can be read, no process is left, and the
folder's lock is free.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from runs import Figures, Setting

from sixthsense.config import load_config
from sixthsense.config.errors import InputError
from sixthsense.figures.run import load
from sixthsense.record.folder import has_record, reason_not_a_run
from sixthsense.record.writing import FolderLock

PROGRAM = "import sys; from sixthsense.cli import main; sys.exit(main())"
SHORT = ("--task", "tour", "--max-time", "5")
STOPS = {"SIGKILL": 1, "SIGTERM": 1, "SIGHUP": 1, "SIGINT": 1, "3 x SIGINT": 3}
CODES = {"SIGKILL": -9, "SIGTERM": 143, "SIGHUP": 129, "SIGINT": 130, "3 x SIGINT": 130}
KINDS = ("run", "replay", "campaign", "live", "run with viewer")
EARLIER_SEED, NEW_SEED = 3, 7
TIMES = 20
DOMAIN = "73"  # of the network of the live runs


@dataclass(frozen=True)
class Case:
    """One command and how it is stopped."""

    kind: str
    stop: str
    onto_earlier: bool
    after_s: float


def command(case: Case, log: Path, out: Path) -> list[str]:
    """The command line of a case."""
    if case.kind == "campaign":
        return ["campaign", "rectangle", "--seeds", "0:6", "--task", "tour", "--max-time", "2", "--workers", "1",
                "--out", str(out)]  # fmt: skip
    words = ["--seed", str(NEW_SEED), "--out", str(out), *(["--overwrite"] if case.onto_earlier else [])]
    if case.kind == "replay":
        return ["replay", str(log), *words]
    if case.kind == "live":
        return ["live", "--domain", DOMAIN, "--max-time", "2", *words]
    return ["run", "rectangle", *SHORT, *words, *(["--view", "browser"] if case.kind == "run with viewer" else [])]


def start(words: list[str], marker: str) -> subprocess.Popen[bytes]:
    """Start a command, whose processes can be found by the marker in their environment."""
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *words], env=os.environ | {"INTERRUPTION": marker},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        preexec_fn=listen,
    )  # fmt: skip


@contextmanager
def robot() -> Iterator[None]:
    """A simulated robot on the network of the live runs."""
    words = "simulate", "rectangle", *SHORT[:2], "--max-time", "100000", "--domain", DOMAIN
    driven = subprocess.Popen([sys.executable, "-c", PROGRAM, *words], stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        driven.kill()
        driven.wait()


def listen() -> None:
    """In the child: no signal is ignored, as under nohup, or blocked, as in the processes of a suite."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGHUP})
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def stop(process: subprocess.Popen[bytes], case: Case) -> int | None:
    """Stop the command after its time; its exit code, None if it had ended before."""
    try:
        process.communicate(timeout=case.after_s)
        return None
    except subprocess.TimeoutExpired:
        for _ in range(STOPS[case.stop]):
            process.send_signal(getattr(signal, case.stop.split()[-1]))
            time.sleep(0.05)
    try:
        error = process.communicate(timeout=120)[1]
    finally:
        process.kill()
    # Before `main` has begun, Python itself answers Ctrl-C with a traceback.
    assert b", in main" not in error and b"Exception ignored" not in error, error.decode()
    return process.returncode


def content(folder: Path) -> dict[str, bytes]:
    """The files of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def check(case: Case, out: Path, earlier: dict[str, bytes]) -> None:
    """Check what is in the folder after a command: the earlier run, or a whole new one."""
    partial = out.with_name(out.name + ".partial")
    with FolderLock(out if case.kind == "campaign" else partial):
        pass
    if case.kind == "campaign":
        from sixthsense.campaigns.call import load_campaign

        rows = load_campaign(out).frame() if (out / "campaign.toml").exists() else []
        assert len(rows) <= 6 and (not len(rows) or set(rows["outcome"]) == {"tour ended"})
        assert len(rows) >= (2 if case.onto_earlier else 0), "rows are lost"
        return
    if has_record(partial):
        try:
            load(partial)
        except InputError as error:
            # A live run is stopped before the robot was heard.
            if "found no scan" not in str(error):
                raise
    if not case.onto_earlier and not out.exists():
        return
    assert reason_not_a_run(out) == "", reason_not_a_run(out)
    if not (case.onto_earlier and content(out) == earlier):
        assert load_config(out / "config.toml").seed == NEW_SEED
        assert "outcome" in load(out).metrics


def left(marker: str) -> list[int]:
    """The processes that a command has left behind."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if f"INTERRUPTION={marker}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append(int(folder.name))
        except OSError:
            continue
    return found


def wait_until_gone(marker: str) -> None:
    """Fail if processes of a command are left after ten seconds."""
    deadline = time.monotonic() + 10.0
    while processes := left(marker):
        assert time.monotonic() < deadline, f"processes are left: {processes}"
        time.sleep(0.1)


def durations(earlier: Path, campaign: Path, log: Path) -> dict[str, float]:
    """Make an earlier run and campaign and a log; the time that each kind of command takes, seconds."""
    times = {}
    for kind in KINDS[:-1]:
        out = {"run": earlier, "campaign": campaign}.get(kind, log.with_name(f"made by {kind}"))
        words = command(Case(kind, "", False, 0.0), log, out)
        if kind == "campaign":
            words[words.index("0:6")] = "0:2"
        if kind == "run":
            words[words.index(str(NEW_SEED))] = str(EARLIER_SEED)
        began = time.monotonic()
        subprocess.run([sys.executable, "-c", PROGRAM, *words], check=True, capture_output=True)
        times[kind] = time.monotonic() - began
        if kind == "run":
            shutil.copytree(earlier, log)
    return times | {"run with viewer": times["run"] + 1.0}


def interrupted(setting: Setting, seed: int) -> Figures:
    """Twenty interruptions; how many have lost something."""
    rng = np.random.default_rng(seed)
    lost = 0
    with tempfile.TemporaryDirectory() as folder, robot():
        earlier, campaign, log = (Path(folder) / name for name in ("earlier", "earlier-campaign", "log"))
        times = durations(earlier, campaign, log)
        before = content(earlier)
        for number in range(TIMES):
            kind, how = str(rng.choice(KINDS)), str(rng.choice(list(STOPS)))
            case = Case(kind, how, bool(rng.integers(2)), float(rng.uniform(0.0, 1.1 * times[kind])))
            place = Path(folder) / f"case-{number}"
            place.mkdir()
            if case.onto_earlier:
                shutil.copytree(campaign if kind == "campaign" else earlier, place / "x")
            marker = f"{os.getpid()}-{number}"
            try:
                code = stop(start(command(case, log, place / "x"), marker), case)
                wait_until_gone(marker)
                check(case, place / "x", before)
                # A signal before the program has installed its handlers, or after its end, has its default effect.
                defaults = {None, 0, CODES[how], -getattr(signal, how.split()[-1])}
                assert code in defaults, f"exit code {code}"
            except Exception as error:
                lost += 1
                print(f"seed {seed}, {case}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
            shutil.rmtree(place, ignore_errors=True)
    return {"stopped": TIMES, "lost": lost}
