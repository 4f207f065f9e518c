"""What `equality.py` runs: explorations, short drives and replays, with the inputs they need."""

from __future__ import annotations

import bz2
import importlib.util
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SCENES = ("rectangle", "block", "apartment", "office", "loop")
SIMULATED = ("ekf", "ekf-invariant", "isam2")
REPLAYED = ("ekf", "ekf-fej", "ekf-oc", "ekf-invariant", "isam2")
LOG_SCANS = 2000  # of a CARMEN log, from its beginning
VICTORIA_STEPS = 500
MRCLAM_S = 189  # in which 500 steps have a measurement
_INTEL = "SIXTHSENSE_DATA=FOLDER with intel/intel.clf.bz2, from ais.informatik.uni-freiburg.de/slamevaluation"
_ACES = "SIXTHSENSE_DATA=FOLDER with aces/aces.clf.bz2, from ais.informatik.uni-freiburg.de/slamevaluation"
_MRCLAM = "SIXTHSENSE_DATA=FOLDER with mrclam6/, set 6 of asrl.utias.utoronto.ca/datasets/mrclam"
_VICTORIA = "gtsam/Data/victoria_park.txt, which the wheel of gtsam has"


@dataclass(frozen=True)
class Case:
    """A run or a replay."""

    name: str
    words: tuple[str, ...]
    """of the command, without seed and folder"""
    needs: str = ""
    """data that are not there, and where they come from"""
    before: tuple[tuple[str, ...], ...] = ()
    """commands that make its inputs, each in a folder `{inputs}/K`, K from 0; `words` may name these"""


def write_map(folder: Path) -> Path:
    """A map of map_server: rooms along a corridor, 12 x 9 m at 0.05 m a cell."""
    cells = np.full((180, 240), 254, dtype=np.uint8)  # [row = y, column = x], turned over when written
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 0, 0, 0, 0
    cells[72:74], cells[108:110] = 0, 0  # the corridor's sides
    cells[2:72, 80:82], cells[2:72, 160:162], cells[110:178, 120:122] = 0, 0, 0
    for row, column in ((72, 30), (72, 110), (72, 190), (108, 50), (108, 170)):
        cells[row : row + 2, column : column + 20] = 254  # doors
    cells[30:46, 110:118], cells[140:148, 60:76] = 0, 0  # pillars
    for k in range(30):
        cells[177 - k, 198 + k : 238] = 0  # a slanted wall
    image = b"P5\n240 180\n255\n" + cells[::-1].tobytes()
    _write(folder / "rooms.pgm", image)
    fields = "resolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    return _write(folder / "rooms.yaml", f"image: rooms.pgm\n{fields}".encode())


def cut_carmen(log: Path, folder: Path) -> Path:
    """A CARMEN log's first scans."""
    lines, scans = [], 0
    with bz2.open(log, "rb") as file:
        for line in file:
            lines.append(line)
            scans += line.startswith(b"FLASER ")
            if scans == LOG_SCANS:
                break
    return _write(folder / log.stem, b"".join(lines))


def cut_victoria(log: Path, folder: Path) -> Path:
    """The graph up to its first poses with an observation."""
    lines: list[bytes] = []
    seen: set[bytes] = set()
    for line in log.read_bytes().splitlines(keepends=True):
        if line.startswith(b"LANDMARK"):
            seen.add(line.split()[1])
        if len(seen) > VICTORIA_STEPS:
            break
        lines.append(line)
    return _write(folder / "victoria_park.txt", b"".join(lines))


def _write(file: Path, data: bytes) -> Path:
    if not file.is_file() or file.read_bytes() != data:
        part = file.with_name(f"{file.name}.{os.getpid()}")  # another call may be reading the file
        part.write_bytes(data)
        part.replace(file)
    return file


def cases(folder: Path) -> list[Case]:
    """All cases; their inputs are written into `folder`."""
    rooms = ("run", str(write_map(folder)), "--start", "1", "4.5", "0")
    found = []
    for name in (*SCENES, "map"):
        start = rooms if name == "map" else ("run", name)
        short = ("--task", "goal", "--goal", "10.5", "2") if name == "map" else ("--task", "tour")  # a map has no tour
        for estimator in SIMULATED:
            words = (*start, "--estimator", estimator)
            found.append(Case(f"{name}.explore.{estimator}", words))
            found.append(Case(f"{name}.{short[1]}.{estimator}", (*words, *short, "--max-time", "60")))
    found += _scan_matching()
    data = Path(os.environ.get("SIXTHSENSE_DATA") or "/nonexistent").resolve()
    gtsam = importlib.util.find_spec("gtsam")
    victoria = Path((gtsam and gtsam.origin) or "/nonexistent").parent / "Data" / "victoria_park.txt"
    mrclam = data / "mrclam6"
    for name, estimators, needs in (("intel", ("isam2", "ekf-invariant"), _INTEL), ("aces", ("isam2",), _ACES)):
        whole = data / name / f"{name}.clf.bz2"
        log = str(cut_carmen(whole, folder)) if whole.is_file() else ""
        found += _replays(name, (log,), estimators, "" if log else needs)
    words = (str(mrclam), "--robot", "3", "--max-time", str(MRCLAM_S))
    found += _replays("mrclam", words, REPLAYED, "" if mrclam.is_dir() else _MRCLAM)
    log = str(cut_victoria(victoria, folder)) if victoria.is_file() else ""
    found += _replays("victoria", (log,), REPLAYED, "" if log else _VICTORIA)
    return found


def _scan_matching() -> list[Case]:
    """Scan matching with each kind of scan, motion and beginning, and landmarks where these differ for them."""
    scans = ("--estimator", "isam2", "--front-end", "scan-matching")
    tour = ("--task", "tour", "--max-time", "60")
    mounted = ("--laser.mount", "0.12", "-0.07", "0.3", "--laser.beams", "271", "--laser.fov", "4.7")
    office, apartment = ("run", "office", *tour), ("run", "apartment", *tour)
    guided = ("--association.proposed-by", "scan-matching")
    walkers = ("--people", "--world.walkers", "4")
    other = (*office, *scans, *mounted, "--tour", "9", "3", "2", "3", "--seed", "11")
    with_map = ("run", "office", "--max-time", "60", "--prior-map", "{inputs}/0")
    found = {
        "office.scans": (*office, *scans, *mounted),
        "office.guided": (*office, *guided),
        "office.guided.people": (*office, *guided, *walkers),
        "office.people.scans": (*office, *scans, *walkers),
        "office.people.ekf-invariant": (*office, *walkers),
        "apartment.swept.scans": (*apartment, *scans, "--laser.sweep-s", "0.09"),
        "apartment.swept.ekf-invariant": (*apartment, "--laser.sweep-s", "0.09"),
        "apartment.no_odometry": (*apartment, *scans, "--no-odometry"),
        "loop.explore.scans": ("run", "loop", *scans),
    }
    cases_of_one = [Case(name, words) for name, words in found.items()]
    first = (*office, *scans, *mounted)
    return [
        *cases_of_one,
        Case("office.bag", ("replay", "{inputs}/0/bag"), before=(first,)),
        Case("office.merged", ("merge", "{inputs}/0", "{inputs}/1"), before=(first, other)),
        Case("office.prior_map.ekf-invariant", with_map, before=(office,)),
        Case("office.prior_map.scans", (*with_map, *scans, "--pose", "2.5", "3", "0.2"), before=(office,)),
        Case("office.lost", (*with_map, "--lost"), before=(office,)),
    ]


def _replays(name: str, words: Sequence[str], estimators: Sequence[str], needs: str) -> list[Case]:
    return [Case(f"{name}.{e}", ("replay", *words, "--estimator", e), needs) for e in estimators]
