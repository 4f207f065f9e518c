"""Run a tree and an earlier commit on the same cases and say whether their results are equal, bit for bit.

    python benchmarks/equality.py --base main~3              # this repository against an earlier commit of its own
    python benchmarks/equality.py --base main~3 --only office intel.isam2

Compared are estimates, landmarks with their joint covariance, all metrics but clocks, and exit codes. Results of the
base stay in the work folder (`.equality-USER` in the system's temporary folder) by commit and case. They are used again
as long as the case and the libraries' versions are the same, so it must be the same machine. Exit codes: 0 all are
equal (a case without its data is skipped, and counted), 1 one or more differ, 2 bad input.
"""

from __future__ import annotations

import argparse
import getpass
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from equality_cases import Case, cases
from harness import HERE, arguments, check_at_least, commit_of, unpack

from sixthsense.logs.runfolder import FILE, read_messages

TRAJECTORIES = ("estimate.tum", "smoothed.tum")
METRICS = "metrics.json"
LANDMARKS = FILE
"""where the landmarks are"""
COMPARED = ("mean", "covariance", "ids", "walls")
CLOCKS = ("wall_time_s", "realtime_factor", "scan_ms_", "stage_ms_mean.")  # what such keys begin with
SEED = 3
LONGEST_S = 3600.0  # of a case


@dataclass(frozen=True)
class Tree:
    """Code to run and a folder for what comes of it."""

    code: Path
    folder: Path

    def out(self, case: Case) -> Path:
        """The folder of a case's run."""
        return self.folder / "cases" / case.name

    def record(self, case: Case) -> Path:
        """What is known of that run."""
        return self.folder / "cases" / f"{case.name}.json"


def identity(case: Case) -> dict[str, Any]:
    """What else, beside the commit, a result depends on."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "numba", "gtsam")}
    return {"words": [list(case.words), *map(list, case.before)], "seed": SEED, "python": sys.version, **libraries}


def perform(case: Case, tree: Tree) -> None:
    """Run a case; of its folder only what is compared stays."""
    out, record = tree.out(case), tree.record(case)
    partial = out.with_name(out.name + ".partial")
    for folder in (out, partial):
        shutil.rmtree(folder, ignore_errors=True)
    record.unlink(missing_ok=True)
    elsewhere = tree.folder / "elsewhere"  # the module must come from PYTHONPATH
    for folder in (out.parent, elsewhere):
        folder.mkdir(parents=True, exist_ok=True)
    inputs = tree.folder / "inputs" / case.name
    shutil.rmtree(inputs, ignore_errors=True)
    # The compiled kernels of one tree must not serve another, nor a later state of this one.
    # One BLAS thread: with two the last bits of a large covariance differ, whatever the code.
    env = os.environ | {"PYTHONPATH": str(tree.code), "NUMBA_CACHE_DIR": str(tree.folder / "numba")}
    env |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    code: int | None = None
    for words, folder in [*((given, inputs / str(k)) for k, given in enumerate(case.before)), (case.words, out)]:
        placed = [word.format(inputs=inputs) for word in words]
        seed = [] if "--seed" in placed else ["--seed", str(SEED)]
        command = [sys.executable, "-m", "sixthsense.cli", *placed, *seed, "--out", str(folder)]
        try:
            done = subprocess.run(command, cwd=elsewhere, env=env, capture_output=True, timeout=LONGEST_S)
            code, said = done.returncode, done.stderr.decode(errors="replace")
        except subprocess.TimeoutExpired:
            code, said = None, f"no end within {LONGEST_S:.0f} s"
        if code not in (0, 1):
            break
    for file in out.glob("*"):
        if file.is_dir():
            shutil.rmtree(file)
        elif file.name not in (*TRAJECTORIES, LANDMARKS, METRICS):
            file.unlink()
    last = [line.strip() for line in said.splitlines() if line.strip()][-1:]
    record.write_text(json.dumps({"code": code, "said": "".join(last), **identity(case)}, indent=1) + "\n")


def has_ended(case: Case, tree: Tree) -> bool:
    """Whether a case came to its end in order, the robot's failure included; a crash has that exit code, too."""
    return _record(case, tree)["code"] in (0, 1) and (tree.out(case) / METRICS).is_file()


def is_recorded(case: Case, tree: Tree) -> bool:
    """Whether the case has been run before, to its end, as it would be now."""
    if not tree.record(case).is_file() or not has_ended(case, tree):
        return False
    return _record(case, tree).items() >= identity(case).items()


def _record(case: Case, tree: Tree) -> dict[str, Any]:
    record: dict[str, Any] = json.loads(tree.record(case).read_text())
    return record


def compare_folders(base: Path, new: Path, ignored: Collection[str] = ()) -> list[str]:
    """What differs between the results in two folders, a line each; none if they are equal."""
    found: list[str] = []
    for name in (*TRAJECTORIES, METRICS):
        lacking = [side for side, folder in (("base", base), ("new", new)) if not (folder / name).is_file()]
        if lacking:
            found.append(f"{name}: missing in {' and '.join(lacking)}")
        elif name == METRICS:
            found += compare_metrics(base / name, new / name, ignored)
        elif (base / name).read_bytes() != (new / name).read_bytes():
            found.append(compare_tum(base, new, name))
    return found + compare_landmarks(base, new)


def compare_tum(base: Path, new: Path, name: str) -> str:
    """Where two trajectories that are not equal part, and how far."""
    a, b = ((folder / name).read_text().splitlines() for folder in (base, new))
    common = min(len(a), len(b))
    first = next((k for k in range(common) if a[k] != b[k]), common) + 1
    said = f"{name}: first differs in line {first}"
    if len(a) != len(b):
        said += f", {len(a)} lines, now {len(b)}"
    try:
        gaps = np.subtract(*([list(map(float, line.split()[1:3])) for line in rows[:common]] for rows in (a, b)))
        return f"{said}, at most {np.hypot(*gaps.reshape(-1, 2).T).max(initial=0.0):.3g} m apart"
    except ValueError:
        return f"{said}, and cannot be read"


def landmarks_of(folder: Path) -> dict[str, Any]:
    """The final pose and landmarks of a run, with their joint covariance."""
    found: dict[str, Any] = {}
    for channel, _, value in read_messages(folder / LANDMARKS)[0]:
        if channel in ("landmarks", "joint_cov", "end"):
            found[channel] = np.concatenate([found[channel], value]) if channel in found else value
    rows = found["landmarks"]
    mean = np.concatenate([found["end"]["pose"], rows["mean"].ravel()])
    return {"mean": mean, "covariance": found["joint_cov"], "ids": rows["landmark"], "walls": rows["is_wall"]}


def compare_landmarks(base: Path, new: Path) -> list[str]:
    """Arrays of the final estimate that differ in type, shape or any bit."""
    found = []
    a, b = landmarks_of(base), landmarks_of(new)
    for key in COMPARED:
        if key not in a or key not in b:
            found.append(
                f"{key}: missing in {' and '.join(s for s, side in (('base', a), ('new', b)) if key not in side)}"
            )
            continue
        x, y = a[key], b[key]
        if (x.dtype, x.shape) != (y.dtype, y.shape):
            found.append(f"{key}: {x.dtype} {x.shape}, now {y.dtype} {y.shape}")
        elif x.tobytes() != y.tobytes():
            gap = np.abs(x.astype(np.float64) - y.astype(np.float64)).max()
            found.append(f"{key}: values differ by {gap:.3g} at most")
    return found


def compare_metrics(base: Path, new: Path, ignored: Collection[str] = ()) -> list[str]:
    """Metrics that are not the same, clocks and `ignored` keys left out; NaN is equal to NaN."""
    a, b = (json.loads(file.read_text()) for file in (base, new))
    keys = sorted(key for key in {*a, *b} if not key.startswith(CLOCKS) and key not in ignored)
    shown = [(key, *(json.dumps(side[key]) if key in side else "missing" for side in (a, b))) for key in keys]
    return [f"{base.name}: {key}: {old}, now {now}" for key, old, now in shown if old != now]


def compare(case: Case, base: Tree, new: Tree, ignored: Collection[str]) -> list[str]:
    """What differs between two trees' results of a case; a case that fails in either is not equal."""
    in_order = has_ended(case, base) and has_ended(case, new)
    a, b = _record(case, base), _record(case, new)
    found = [] if in_order and a["code"] == b["code"] else [_ending("base", a), _ending("new", b)]
    return found + (compare_folders(base.out(case), new.out(case), ignored) if in_order else [])


def _ending(name: str, record: dict[str, Any]) -> str:
    return f"{name} ends with exit code {record['code']}" + (f": {record['said']}" if record["code"] != 0 else "")


def check_package(tree: Tree) -> None:
    """Raise RuntimeError if another package than a tree's own would run."""
    words = [sys.executable, "-c", "import sixthsense; print(sixthsense.__file__)"]
    env = os.environ | {"PYTHONPATH": str(tree.code)}
    found = subprocess.run(words, cwd=tree.folder, env=env, capture_output=True, text=True).stdout.strip()
    if not Path(found).is_relative_to(tree.code):
        raise RuntimeError(f"{tree.code}: found the package in {found or 'no place'}, allowed: a tree that has its own")


def carry_out(base: Tree, new: Tree, ignored: Collection[str], case: Case) -> list[str]:
    """Run what has to be run of a case; what differs."""
    if not is_recorded(case, base):
        perform(case, base)
    perform(case, new)
    return compare(case, base, new, ignored)


def carry_out_all(chosen: Sequence[Case], base: Tree, new: Tree, options: argparse.Namespace) -> int:
    """Run the cases side by side and print a row for each; how many are equal."""
    width, equal = max(len(case.name) for case in chosen), 0
    pool, work = ThreadPoolExecutor(options.jobs), partial(carry_out, base, new, options.ignore)
    try:
        waiting = [(case, None if case.needs else pool.submit(work, case)) for case in chosen]
        for case, future in waiting:
            if future is None:
                print(f"{case.name:{width}}  skipped: needs {case.needs}")
                continue
            found = future.result()
            equal += not found
            print("\n    ".join([f"{case.name:{width}}  {'differs' if found else 'equal'}", *found]), flush=True)
    finally:
        pool.shutdown(cancel_futures=True)
    return equal


def main() -> int:
    parser = arguments(__doc__, may_keep=False)
    parser.add_argument("--base", metavar="REV", required=True, help="earlier commit")
    work = Path(tempfile.gettempdir()) / f".equality-{getpass.getuser()}"
    parser.add_argument("--work", type=Path, default=work, metavar="DIR", help=f"work folder ({work})")
    parser.add_argument("--only", nargs="+", default=[""], metavar="TEXT", help="cases with one of these in their name")
    parser.add_argument("--ignore", nargs="+", default=[], metavar="KEY", help="metrics to leave out")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="cases at a time (2)")
    options = parser.parse_args()
    check_at_least(parser, options, jobs=1)
    folder = options.work.resolve()
    try:
        commit = commit_of(options.base)
        of_base = folder / f"base-{commit[:12]}"
        base, new = Tree(of_base / "tree", of_base), Tree(HERE.parent, folder / "tree")
        shutil.rmtree(new.folder, ignore_errors=True)
        for place in (folder / "inputs", base.folder, new.folder):
            place.mkdir(parents=True, exist_ok=True)
        chosen = [case for case in cases(folder / "inputs") if any(text in case.name for text in options.only)]
        if not chosen:
            raise RuntimeError(f"--only: found {' '.join(options.only)}, which is in no case's name")
        if not base.code.exists():
            unpack(commit, base.code)
        for tree in (base, new):
            check_package(tree)
    except RuntimeError as error:
        print(f"equality.py: {error}", file=sys.stderr)
        return 2
    equal, ready = carry_out_all(chosen, base, new, options), [case for case in chosen if not case.needs]
    skipped = f", {len(chosen) - len(ready)} skipped" if len(chosen) > len(ready) else ""
    print(f"{equal} of {len(ready)} equal{skipped}")
    return int(equal < len(ready))


if __name__ == "__main__":
    sys.exit(main())
