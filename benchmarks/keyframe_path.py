"""Through how many functions and files of the package one tick passes: a measure of how much a reader must hold.

    SIXTHSENSE_DATA=FOLDER python benchmarks/keyframe_path.py     # scan matching on the Intel log
    python benchmarks/keyframe_path.py --scene apartment          # landmarks in a scene
    python benchmarks/keyframe_path.py --list                     # and the functions that most keyframes pass, by file

For each kind of tick the median over a run of what `sys.setprofile` sees in one call of `Slam.take`: calls of the
package's Python functions, different functions, and files. Compiled kernels count where Python calls them.
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from harness import arguments, data_path

import sixthsense
from sixthsense.config import Config, preset
from sixthsense.core.source import Command, Source, Tick
from sixthsense.logs.log import Playback
from sixthsense.logs.replay_input import open_recorded
from sixthsense.simulation.mission import mission_of
from sixthsense.slam.slam import Slam

PACKAGE = str(Path(sixthsense.__file__).parent)
TICKS = 3000


class Passed:
    """What one call has passed."""

    def __init__(self) -> None:
        self.calls = 0
        self.functions: set[tuple[str, int, str]] = set()

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Count a call of a function of the package."""
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE) and not code.co_name.startswith("<"):
            self.calls += 1
            self.functions.add((code.co_filename, code.co_firstlineno, code.co_qualname))

    def row(self) -> tuple[int, int, int]:
        """Calls, functions and files."""
        return self.calls, len(self.functions), len({file for file, *_ in self.functions})


def taken(slam: Slam, tick: Tick) -> tuple[str, Passed]:
    """The kind of a tick, and what it has passed."""
    seen = Passed()
    sys.setprofile(seen)
    try:
        step = slam.take(tick)
    finally:
        sys.setprofile(None)
    kind = "keyframe" if step.keyframe is not None else "scan" if tick.scan is not None else "odometry"
    return kind, seen


def source_of(scene: str | None) -> tuple[Source, Config]:
    """The scene driven on a circle, or the Intel log."""
    if scene is not None:
        config, mission = mission_of(preset(scene=scene), None)
        return mission.world(config), config
    found = open_recorded(data_path("intel/intel.clf.bz2"), preset("log"))
    return Playback(found.log.ticks), found.config


def main() -> int:
    parser = arguments(__doc__, may_keep=False)
    parser.add_argument("--scene", help="a shipped scene")
    parser.add_argument("--list", action="store_true", help="also print the functions that most keyframes pass")
    options = parser.parse_args()
    source, config = source_of(options.scene)
    passed: dict[str, list[Passed]] = defaultdict(list)
    with Slam(config) as slam:
        for _ in range(TICKS):
            tick = source.step(Command(0.2, 0.3))
            if tick is None:
                break
            kind, seen = taken(slam, tick)
            passed[kind].append(seen)
    print(f"{'tick':10} {'seen':>6} {'calls':>7} {'functions':>10} {'files':>6}")
    for kind, found in passed.items():
        calls, functions, files = np.median([each.row() for each in found], axis=0)
        print(f"{kind:10} {len(found):6} {calls:7.0f} {functions:10.0f} {files:6.0f}")
    if options.list:
        keyframes = passed["keyframe"]
        times = Counter(function for each in keyframes for function in each.functions)
        for (file, line, name), count in sorted(times.items()):
            if 2 * count >= len(keyframes):
                print(f"{file.removeprefix(PACKAGE)[1:]}:{line} {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
