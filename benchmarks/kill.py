"""Kill runs at random times and measure how much of the record is lost: `python benchmarks/kill.py --kills 50`."""

from __future__ import annotations

import argparse
import mmap
import signal
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sixthsense.figures.run import load

# The command, which also writes the last recorded and the last flushed stamp into shared memory.
CHILD = """
import mmap, struct, sys
from sixthsense import cli
from sixthsense.record import bag
with open(sys.argv[1], "r+b") as file:
    notes = mmap.mmap(file.fileno(), 16)
call, flush = bag.BagWriter.__call__, bag.BagWriter._flush
def noting_call(self, tick, trace):
    notes[0:8] = struct.pack("<q", tick.stamp_ns)
    call(self, tick, trace)
def noting_flush(self):
    flush(self)
    notes[8:16] = notes[0:8]
bag.BagWriter.__call__, bag.BagWriter._flush = noting_call, noting_flush
sys.exit(cli.main(sys.argv[2:]))
"""


@dataclass(frozen=True)
class Kill:
    """The folder of a killed run and its progress at that time."""

    partial: Path
    """the folder"""
    recorded_ns: int
    """stamp of the last tick passed to the bag writer"""
    flushed_ns: int
    """stamp of the last flushed tick"""
    lost_wall_s: float
    """time since bag and record were both last written"""


def kill_one(folder: Path, after_s: float, seed: int = 0) -> Kill:
    """Start a run in `folder` and kill it `after_s` seconds after its first tick is on disk."""
    notes = folder / "notes"
    notes.write_bytes(struct.pack("<qq", -1, -1))
    words = ["run", "--task", "tour", "--max-time", "1e6", "--seed", str(seed), "--out", str(folder / "run")]
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
    recorded_ns, flushed_ns = struct.unpack("<qq", notes.read_bytes())
    partial = folder / "run.partial"
    written = min((partial / name).stat().st_mtime for name in ("bag/bag_0.mcap", "record.jsonl"))
    return Kill(partial, recorded_ns, flushed_ns, killed - written)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--longest", type=float, default=6.0, help="longest wall time, s, after which a run is killed")
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    wall, simulated = [], []
    for number in range(options.kills):
        with tempfile.TemporaryDirectory() as folder:
            after_s = float(rng.uniform(0.0, options.longest))
            kill = kill_one(Path(folder), after_s, number)
            run = load(kill.partial)
            trace = run.trace
            last_ns = trace.stamps_ns[-1] + 100_000_000  # ticks after the last scan are not in the trace
            wall.append(kill.lost_wall_s)
            simulated.append(max(0.0, 1e-9 * (kill.recorded_ns - last_ns)))
            print(
                f"{number + 1:3d}  killed after {after_s:.2f} s at {1e-9 * kill.recorded_ns:6.1f} s simulated, "
                f"lost {wall[-1]:.3f} s of wall time, {simulated[-1]:5.1f} s simulated; "
                f"ATE {run.metrics['ate_rmse_m']:.4f} m",
                flush=True,
            )
            assert last_ns >= kill.flushed_ns, "more than the last chunk is lost"
            assert wall[-1] < 1.0, "no chunk was written in the last second"
    print(f"lost at most {max(wall):.3f} s of wall time ({max(simulated):.1f} s simulated) in {options.kills} kills")


if __name__ == "__main__":
    main()
