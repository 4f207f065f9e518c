import errno
import mmap
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from sixthsense import cli
from sixthsense.config import preset
from sixthsense.figures.plot import save_map
from sixthsense.figures.run import load
from sixthsense.logs.runfolder import FILE, read_run
from sixthsense.loop.run import replay, run
from sixthsense.record import exports, folder

pytestmark = pytest.mark.usefixtures("compiled")

RUN = ["run", "rectangle", "--task", "tour", "--max-time", "3"]


# The command, which also writes the last recorded and the last flushed stamp into shared memory.
CHILD = """
import mmap, struct, sys
from sixthsense import cli
from sixthsense.record.stream import RecordWriter
with open(sys.argv[1], "r+b") as file:
    notes = mmap.mmap(file.fileno(), 16)
call, flush = RecordWriter.__call__, RecordWriter._flush
def noting_call(self, tick, trace):
    notes[0:8] = struct.pack("<q", tick.stamp_ns)
    call(self, tick, trace)
def noting_flush(self):
    flush(self)
    notes[8:16] = notes[0:8]
RecordWriter.__call__, RecordWriter._flush = noting_call, noting_flush
sys.exit(cli.main(sys.argv[2:]))
"""


class Kill(NamedTuple):
    """The folder of a killed run, the stamp of the last flushed tick, and the time since the last writing."""

    partial: Path
    flushed_ns: int
    lost_wall_s: float


def kill_one(folder: Path, after_s: float) -> Kill:
    """Start a run in `folder` and kill it `after_s` seconds after its first tick is on disk."""
    notes = folder / "notes"
    notes.write_bytes(struct.pack("<qq", -1, -1))
    words = ["run", "--task", "tour", "--max-time", "1e6", "--out", str(folder / "run")]
    command = [sys.executable, "-c", CHILD, str(notes), *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as child:
        with notes.open("r+b") as file, mmap.mmap(file.fileno(), 16, access=mmap.ACCESS_READ) as seen:
            while seen[8:16] == b"\xff" * 8:
                if child.poll() is not None:
                    raise RuntimeError(f"the run ended before it was killed, with exit code {child.returncode}")
                time.sleep(0.01)
        time.sleep(after_s)
        child.send_signal(signal.SIGKILL)
        killed = time.time()
        child.wait()
    _, flushed_ns = struct.unpack("<qq", notes.read_bytes())
    partial = folder / "run.partial"
    return Kill(partial, flushed_ns, killed - (partial / FILE).stat().st_mtime)


@pytest.fixture(scope="module")
def kill(tmp_path_factory):
    return kill_one(tmp_path_factory.mktemp("killed"), float(np.random.default_rng().uniform(0.0, 1.5)))


def test_a_run_killed_at_any_moment_loses_at_most_its_last_chunk(kill):
    trace = load(kill.partial).trace
    whole = run(preset(task="tour", max_time=max(1e-9 * trace.stamps_ns[-1], 0.1)))  # on a busy machine one tick
    count = len(trace.stamps_ns)
    assert trace.stamps_ns[-1] + 100_000_000 > kill.flushed_ns  # the last scan before the last tick flushed
    assert kill.lost_wall_s < 1.0
    assert trace.outcome == "interrupted"
    assert np.array_equal(np.array(trace.estimates), np.array(whole.estimates[:count]))
    assert np.array_equal(np.array(trace.truths), np.array(whole.truths[:count]))
    again = replay(read_run(kill.partial, trace.config.laser), trace.config)
    assert again.stamps_ns[-1] + 100_000_000 > kill.flushed_ns
    assert np.array_equal(np.array(again.estimates), np.array(whole.estimates[: len(again.estimates)]))


def test_what_a_killed_run_leaves_is_replayed_measured_and_drawn(kill, tmp_path, capsys):
    partial = kill.partial
    assert cli.main(["replay", str(partial), "--out", str(tmp_path / "again")]) == cli.DONE
    out, err = capsys.readouterr()
    assert "\naccuracy     position error " in out
    assert "the recording is incomplete" in err and err.count("\n") == 1
    save_map(load(partial), tmp_path / "map.png", "a killed run")
    assert (tmp_path / "map.png").is_file()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, a disk that is always full")
def test_a_full_disk_ends_the_run_in_one_line(tmp_path, complaint, monkeypatch):
    monkeypatch.setattr(folder, "FILE", "/dev/full")
    said = complaint(*RUN, "--out", tmp_path / "x", writes_nothing=False, code=cli.DISK_FULL)
    assert "/dev/full: No space left on device" in said
    assert not (tmp_path / "x").exists()


def test_a_disk_that_fills_up_at_the_end_leaves_the_evidence(tmp_path, complaint, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(exports, "write_landmarks", full)
    said = complaint(*RUN, "--out", tmp_path / "x", writes_nothing=False, code=cli.DISK_FULL)
    assert "x.partial: No space left on device" in said
    assert len(load(tmp_path / "x.partial").trace.estimates) > 20
