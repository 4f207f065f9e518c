"""The commands of the README from the built wheel, in an empty environment and outside the repository.

    SIXTHSENSE_DATA=FOLDER python benchmarks/wheel.py --python python3.11 python3.12 python3.13

Each command is the README's with a shorter drive. A line of the README without a row here is an error, and so is a row
without a line. Without SIXTHSENSE_DATA the rows that need its logs are left out.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from harness import arguments, print_table

ROOT = Path(__file__).parents[1]
SHORT = "--task tour --max-time 4"
EXTRAS = "ros2,view,campaign"
BY_HAND = ("run apartment --view", "run apartment --view browser", "campaign ... --scheduler tcp://HOST:8786")
"""they need a screen, a browser and another machine"""
ROWS = (
    ("run apartment --seed 1 --out runs/monday", "run apartment --seed 1 --out runs/monday --task tour --max-time 60"),
    (
        "run apartment --seed 2 --prior-map runs/monday --out runs/tuesday",
        "run apartment --seed 2 --prior-map runs/monday --out runs/tuesday --task tour --max-time 60",
    ),
    ("merge runs/monday runs/tuesday", "merge runs/monday runs/tuesday --out runs/merged"),
    ("run office --seed 3 --estimator isam2", f"run office --seed 3 --estimator isam2 {SHORT} --out runs/first"),
    ("run apartment --goal 0.8 8.2 --planner rrtstar", "run apartment --goal 0.8 8.2 --planner rrtstar"),
    ("run apartment --task tour --max-time 300 --preset worn", f"run apartment {SHORT} --preset worn"),
    ("run block --features.landmarks corners", f"run block --features.landmarks corners {SHORT}"),
    ("run map.yaml --start 1 2 0 --goal 12 5", "run map.yaml --start 1 2 0 --goal 5 2"),
    ("replay robot.bag", "replay runs/first/bag"),
    (
        "replay intel.clf.bz2 --relations intel.relations",
        "replay DATA/intel/intel.clf.bz2 --relations DATA/intel/intel.relations --max-time 120",
    ),
    (
        "replay intel.clf.bz2 --estimator ekf-invariant",
        "replay DATA/intel/intel.clf.bz2 --estimator ekf-invariant --max-time 60",
    ),
    ("replay mrclam6 --robot 3", "replay DATA/mrclam6 --robot 3 --max-time 60"),
    ("replay fr079.clf.bz2 --relations fr079.relations", "replay DATA/fr079/fr079.clf.bz2 --max-time 60"),
    ("replay victoria_park.txt", "replay graph.g2o"),
    ("live --interface wlan0", "live --domain 62 --max-time 3"),
    ("run loop --view", f"run loop {SHORT} --view loop.rrd"),
    ("run apartment --view run.rrd", f"run apartment {SHORT} --view run.rrd"),
    ("report runs/first", "report runs/first"),
    ("run --help", "run --help"),
    (
        "calibrate apartment --preset worn --out noise.toml",
        "calibrate apartment --preset worn --samples 20 --out noise.toml",
    ),
    (
        "run apartment --preset worn --config noise.toml --out runs/calibrated",
        f"run apartment --preset worn --config noise.toml --out runs/calibrated {SHORT}",
    ),
    ("replay runs/calibrated", "replay runs/calibrated"),
    ("report runs/first runs/calibrated", "report runs/first runs/calibrated"),
    ("report runs/first --animate run.mp4 --figures pdf", "report runs/first --animate run.gif --figures pdf"),
    (
        "campaign apartment block --seeds 0:50 --estimator ekf isam2 --task tour --max-time 400 --out mc",
        "campaign apartment block --seeds 0:2 --estimator ekf isam2 --task tour --max-time 4 --out mc",
    ),
)
"""a line of the README, and what is run for it, in this order"""


def lines_of(readme: str) -> list[str]:
    """The commands of the README, without comments."""
    return [re.sub(r"\s+#.*$", "", line).strip() for line in re.findall(r"^ {4}sixthsense (.*)$", readme, re.MULTILINE)]


def write_inputs(folder: Path) -> None:
    """A map of a room, and a graph of landmarks."""
    pixels = np.full((80, 120), 254, dtype=np.uint8)
    pixels[[0, -1]], pixels[:, [0, -1]] = 0, 0
    (folder / "map.pgm").write_bytes(b"P5\n120 80\n255\n" + pixels.tobytes())
    meta = "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (folder / "map.yaml").write_text(meta)
    seen = [f"EDGE_SE2_XY {k} {100 + j} {j - k} 2 100 0 100" for k in range(20) for j in range(20)]
    moved = [f"EDGE_SE2 {k} {k + 1} 1 0 0 100 0 0 100 0 400" for k in range(19)]
    (folder / "graph.g2o").write_text("\n".join(moved + seen) + "\n")


@contextmanager
def environment(python: str, wheel: Path) -> Iterator[tuple[Path, Path]]:
    """An environment that has nothing but the wheel: its programs, and an empty folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([python, "-m", "venv", folder / "venv"], check=True)
        programs = folder / "venv" / "bin"
        install = [programs / "python", "-m", "pip", "install", "--quiet", f"{wheel}[{EXTRAS}]"]
        subprocess.run(install, check=True, stderr=subprocess.DEVNULL)
        (folder / "work").mkdir()
        yield programs, folder / "work"


def outcome(programs: Path, work: Path, words: list[str]) -> str:
    """The exit code of a command and the seconds it took; its last line if it failed."""
    robot = None
    if words[0] == "live":
        simulate = [programs / "sixthsense", "simulate", "rectangle", "--task", "tour", "--domain", "62"]
        robot = subprocess.Popen(simulate, cwd=work, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    began = time.monotonic()
    try:
        done = subprocess.run([programs / "sixthsense", *words], cwd=work, capture_output=True, text=True, timeout=600)
    finally:
        if robot is not None:
            robot.terminate()
            robot.wait()
    said = "" if done.returncode == 0 else " " + (done.stderr.strip().splitlines() or [""])[-1]
    return f"{done.returncode}, {time.monotonic() - began:.0f} s{said}"


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--python", nargs="+", default=[sys.executable], metavar="PROGRAM")
    options = parser.parse_args()
    lines, known = lines_of((ROOT / "README.md").read_text(encoding="utf-8")), {*dict(ROWS), *BY_HAND}
    if set(lines) != known:
        sys.exit(f"README: found {sorted(set(lines) ^ known)} in one of the README and the rows of this script")
    data = os.environ.get("SIXTHSENSE_DATA")
    rows = [[ran.replace("DATA", str(data))] for _, ran in ROWS if data or "DATA" not in ran]
    with tempfile.TemporaryDirectory() as folder:
        build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, str(ROOT)]
        subprocess.run(build, check=True, stderr=subprocess.DEVNULL)
        (wheel,) = Path(folder).glob("*.whl")
        for python in options.python:
            with environment(python, wheel) as (programs, work):
                write_inputs(work)
                for row in rows:
                    row.append(outcome(programs, work, row[0].split()))
                    print(python, row[0], row[-1], flush=True)
    print_table([["command, exit code and time", *options.python], *rows])
    sys.exit(any(not cell.startswith("0,") for row in rows for cell in row[1:]))


if __name__ == "__main__":
    main()
