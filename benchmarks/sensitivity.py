"""What do the figures of scan matching hang on? Constants by group, halved and doubled, on one log.

    SIXTHSENSE_DATA=FOLDER python benchmarks/sensitivity.py              # Freiburg 079, all constants
    python benchmarks/sensitivity.py --only evidence                     # constants whose key begins so

Each run replays the log with the defaults by a copy of the package in which one constant is changed. A least share is
moved to half and to double its distance from 1. Figures of each run are a row of a file named after the code's commit,
so that the same command resumes.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from harness import CACHE, arguments, code_commit, data_path, finish, replay_errors
from tqdm import tqdm

from sixthsense.campaigns.engine import Rows
from sixthsense.config import preset
from sixthsense.logs.replay_input import open_recorded

HERE = Path(__file__).resolve()
PACKAGE = HERE.parent.parent / "sixthsense"
LOG = "fr079"
GROUPS = {
    "aligner": ("alignment.SIGMA_M", "alignment.SCALE_M", "alignment.NORMALS_AGREE"),
    "normals": ("returns._REACH_M", "returns._GRAZING_RAD"),
    "gates": ("links.NEAR_GATE_M", "links.WIDE_GATE_M", "links.SEEN_SHARE"),
    "link covariance": ("links.FEW_RETURNS", "links._SHAPE_SHARE", "graph.LOSS"),
    "links": ("graph.LINKS", "graph.REACH_M", "graph.AGREEMENT"),
    "visibility": ("visibility._LEAST_JUDGED",),
    "odometry": ("motion_source.UNSTEADY",),
    "slips": (
        "tracking.SLIP_SIGMAS", "tracking._DOUBTED", "tracking._SLIPS", "tracking._TELLS_NOTHING",
        "tracking._NEWEST_SHARE",
    ),
    "uncertainty": (
        "loop_closures._DRIFT_M", "loop_closures._DRIFT_RAD",
        "loop_closures._CERTAIN_M",
    ),
    "place search": (
        "place_search.RECENT_M", "place_search.SIGMAS", "place_search._MARGIN_M", "place_search._AS_GOOD",
        "place_search._CANDIDATES",
    ),
    "evidence": ("place_search._CLEARLY", "place_search._PARTNERS", "place_search._SCANS_BEYOND"),
    "verification": ("place_search._GOOD_SHARE",),
    "votes": ("place_search.NEW_M", "graph._CONTRADICTION"),
    "thinning": ("graph._ENOUGH", "graph._NEAR_M"),
}  # fmt: skip
SHARES = {"NORMALS_AGREE", "AGREEMENT", "_DOUBTED", "_AS_GOOD"}
"""least shares, which cannot be doubled"""
HEAD = ["group", "constant", "value", "lower", "mean, m", "largest, m", "higher", "mean, m", "largest, m"]


class Constant(NamedTuple):
    """A number in the source."""

    path: Path
    line: int
    columns: tuple[int, int]
    value: float


def constant(name: str) -> Constant:
    """The number that a module of scan matching binds to a name, alone or in a tuple; `name` is `module.NAME`."""
    module, _, wanted = name.partition(".")
    rooms = PACKAGE / "slam" / "scans", PACKAGE / "slam"
    path = next(file for file in (room / f"{module}.py" for room in rooms) if file.is_file())
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign):
            target = node.targets[0]
            targets = target.elts if isinstance(target, ast.Tuple) else [target]
            values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            for at, value in zip(targets, values, strict=False):
                if isinstance(at, ast.Name) and at.id == wanted and isinstance(value, ast.Constant):
                    assert isinstance(value.value, int | float)
                    assert value.end_col_offset is not None
                    return Constant(path, value.lineno, (value.col_offset, value.end_col_offset), value.value)
    raise SystemExit(f"sensitivity: found no number {name} in {path.name}")


def changed(name: str, value: float) -> tuple[float, float]:
    """The two values that a constant is given."""
    if name.partition(".")[2] in SHARES:
        return 1.0 - 2.0 * (1.0 - value), 1.0 - 0.5 * (1.0 - value)
    if isinstance(value, int):
        return max(1, value // 2), 2 * value
    return 0.5 * value, 2.0 * value


def errors_with(name: str, value: float) -> dict[str, float]:
    """Errors of the log, replayed by a copy of the package with another value of a constant."""
    found = constant(name)
    with tempfile.TemporaryDirectory() as folder:
        # With its kernels, which are compiled again only where they may hold the constant.
        shutil.copytree(PACKAGE, Path(folder) / "sixthsense", copy_function=shutil.copy2)
        room = Path(folder) / "sixthsense" / found.path.relative_to(PACKAGE).parent
        path = room / found.path.name
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        line, (first, last) = lines[found.line - 1], found.columns
        lines[found.line - 1] = f"{line[:first]}{value:.9g}{line[last:]}"
        path.write_text("".join(lines), encoding="utf-8")
        if "numba" in path.read_text(encoding="utf-8"):
            shutil.rmtree(room / "__pycache__", ignore_errors=True)
        environment = {**os.environ, "PYTHONPATH": folder, "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, str(HERE), "--replay"]
        done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def replayed() -> dict[str, float]:
    """Errors of the log by the package that is imported."""
    folder = data_path(LOG)
    recorded = open_recorded(folder / f"{LOG}.clf.bz2", preset("log"), folder / f"{LOG}.relations")
    assert recorded.relations is not None
    found = replay_errors(recorded.log, recorded.config, recorded.relations)
    return {key: found[key] for key in ("mean_m", "largest_m")}


def line(group: str, name: str, rows: Rows) -> list[str]:
    """A line of the table, measured where there are no figures of it yet."""
    value = constant(name).value
    cells = [group, f"`{name}`", f"{value:g}"]
    for other in changed(name, value):
        key = f"{name}-{other:g}"
        found = rows.read().get(key)
        if found is None:
            found = errors_with(name, other)
            rows.add({"key": key, **found})
        cells += [f"{other:g}", f"{found['mean_m']:.4f}", f"{found['largest_m']:.2f}"]
    return cells


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--only", nargs="+", default=[""], metavar="GROUP", help="groups whose name begins so (all)")
    parser.add_argument("--replay", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.replay:
        print(json.dumps(replayed()))
        return
    if not data_path(LOG).exists():
        parser.error(f"SIXTHSENSE_DATA: found no folder {LOG} there, allowed: the folder of the real data")
    chosen = [group for group in GROUPS if group.startswith(tuple(options.only))]
    due = [(group, name) for group in chosen for name in GROUPS[group]]
    rows = Rows(CACHE / f"{code_commit()}.sensitivity.jsonl")
    lines = [line(*each, rows) for each in tqdm(due, unit=" constants", disable=None, leave=False)]
    finish(options, "sensitivity", [HEAD, *lines], text=2)


if __name__ == "__main__":
    main()
