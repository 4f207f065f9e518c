"""Make small wrong changes to the code, one at a time, and see whether the tests of the room fail; `make mutants`.

    python tests/mutants.py PATH... [--sample N] [--seed S] [--out FILE]

A path is a file or a folder of the package. Two processes work, each in a copy of the tree. A result is a line of JSON
in FILE.
"""

import argparse
import ast
import contextlib
import difflib
import itertools
import json
import os
import queue
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "sixthsense"
SIGNS = """
    Lt:<:<= LtE:<=:< Gt:>:>= GtE:>=:> Eq:==:!= NotEq:!=:== Is:is:is_not IsNot:is_not:is In:in:not_in NotIn:not_in:in
    And:and:or Or:or:and Add:+:- Sub:-:+ Mult:*:/ Div:/:* FloorDiv://:* Mod:%:* Pow:**:* BitAnd:&:| BitOr:|:&"""
OPERATORS = {name: (old, new) for name, old, new in (one.replace("_", " ").split(":") for one in SIGNS.split())}
PAIRS = """min:max minimum:maximum sin:cos argmin:argmax any:all floor:ceil logical_and:logical_or x:y row:col rows:cols
    width:height zeros:ones first:last begin:end lower:upper std:var"""
NEIGHBOURS = {name: other for a, b in (one.split(":") for one in PAIRS.split()) for name, other in ((a, b), (b, a))}
SYMMETRIC = ("min", "max", "minimum", "maximum", "hypot", "allclose", "array_equal", "dist")

Change = tuple[int, int, bytes, str]
"""first byte, byte behind the last, what is written in their place, kind of mutation"""


def changes(text: str) -> dict[Change, bool]:
    """All mutations of a source text, but for messages, annotations, decorators and imports.

    With each, whether a kernel may hold it: it lies in a kernel or outside functions.
    """
    source = text.encode()
    starts = [0, *(m.end() for m in re.finditer(b"\n", source))]

    def span(node: Any) -> tuple[int, int]:
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    def code(node: Any) -> bytes:
        return source[slice(*span(node))]

    def swap(kind: str, first: Any, second: Any) -> Change:
        (a, b), (c, d) = span(first), span(second)
        return a, d, source[c:d] + source[b:c] + source[a:b], kind

    def between(operands: list[Any], operators: list[Any]) -> Iterator[Change]:
        for (left, right), operator in zip(itertools.pairwise(operands), operators, strict=False):
            old, new = OPERATORS.get(type(operator).__name__, (" ", " "))
            a, b = span(left)[1], span(right)[0]
            yield a, b, source[a:b].replace(old.encode(), new.encode(), 1), "operator"

    def of(node: Any) -> Iterator[Change]:
        match node:
            case ast.Compare():
                yield from between([node.left, *node.comparators], node.ops)
            case ast.BoolOp():
                yield from between(node.values, [node.op] * len(node.values))
            case ast.BinOp(op=ast.MatMult()):
                yield swap("swapped factors", node.left, node.right)
            case ast.BinOp():
                yield from between([node.left, node.right], [node.op])
                if isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div):
                    yield *span(node), b"(" + code(node.left) + b")", "dropped term"
                    if isinstance(node.op, ast.Add | ast.Mult):
                        yield *span(node), b"(" + code(node.right) + b")", "dropped term"
            case ast.AugAssign():
                yield from between([node.target, node.value], [node.op])
                yield *span(node), b"pass", "dropped statement"
            case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert()):
                yield *span(node), code(node.operand), "sign"
            case ast.Constant(value=bool()):
                yield *span(node), str(not node.value).encode(), "constant"
            case ast.Constant(value=int() | float()):
                other = node.value + 1 if isinstance(node.value, int) or node.value == 0 else 2 * node.value
                yield *span(node), repr(other).encode(), "constant"
            case ast.If() | ast.While() | ast.IfExp():
                yield *span(node.test), b"not (" + code(node.test) + b")", "condition"
                if isinstance(node, ast.If) and isinstance(node.body[0], ast.Raise):
                    yield *span(node.test), b"False", "removed guard"
            case ast.comprehension():
                yield from ((*span(one), b"not (" + code(one) + b")", "condition") for one in node.ifs)
            case ast.Call():
                plain = [one for one in node.args if not isinstance(one, ast.Starred)]
                if ast.unparse(node.func).rpartition(".")[2] not in SYMMETRIC:
                    yield from (swap("swapped arguments", *pair) for pair in itertools.pairwise(plain))
            case ast.Slice():
                bounds = [bound for bound in (node.lower, node.upper) if bound is not None]
                yield from ((*span(bound), code(bound) + b" + 1", "slice") for bound in bounds)
            case ast.Return(value=ast.Tuple(elts=[one, other, *_])):
                yield swap("swapped results", one, other)
            case ast.Return(value=ast.BinOp()) | ast.Assign(value=ast.BinOp(op=ast.Mult() | ast.Div())):
                yield *span(node.value), b"-(" + code(node.value) + b")", "sign"
            case ast.Return(value=ast.Name() | ast.Attribute() | ast.Call()):
                yield *span(node.value), b"None", "returned value"
            case ast.Expr(value=ast.Call()) | ast.Continue() | ast.Break():
                yield *span(node), b"pass", "dropped statement"
            case ast.Attribute(attr=name) if name in NEIGHBOURS:
                yield span(node)[1] - len(name), span(node)[1], NEIGHBOURS[name].encode(), "neighbour"
            case ast.Name(id=name) if name in ("min", "max", "any", "all"):
                yield *span(node), NEIGHBOURS[name].encode(), "neighbour"

    def visit(node: ast.AST, compiled: bool = True) -> Iterator[tuple[Change, bool]]:
        if isinstance(node, ast.FunctionDef):
            compiled = any("njit" in ast.unparse(one) for one in node.decorator_list)
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Assert):
            return
        yield from ((one, compiled) for one in of(node))
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns", "decorator_list"):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        yield from visit(child, compiled)

    return {one: compiled for one, compiled in visit(ast.parse(text)) if one[2] != source[slice(*one[:2])]}


def importers(path: str) -> set[str]:
    """A file and those that import it, directly or not: their kernels may hold what it says."""
    texts = {str(file.relative_to(ROOT)): file.read_text() for file in (ROOT / PACKAGE).rglob("*.py")}
    found, todo = {path}, [path]
    while todo:
        folder, name = str(Path(todo[0]).parent).replace("/", "."), Path(todo.pop(0)).stem
        pattern = re.compile(rf"from {re.escape(folder)}(\.{name} import| import .*\b{name}\b)")
        new = {one for one, text in texts.items() if one not in found and pattern.search(text)}
        found, todo = found | new, todo + sorted(new)
    return found


def tests_of(path: str) -> list[str]:
    """The test files of a file's room, or else of the folder above it; those that import the file first."""
    room = Path(path).relative_to(PACKAGE).parent
    while not (files := sorted((ROOT / "tests" / room).glob("test_*.py"))):
        room = room.parent
    module = str(Path(path).with_suffix("")).replace("/", ".")
    return [str(file.relative_to(ROOT)) for file in sorted(files, key=lambda file: module not in file.read_text())]


def run_tests(root: Path, tests: list[str], limit: float | None = None) -> str:
    own = {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", *tests]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    process = subprocess.Popen(command, cwd=root, env={**os.environ, **own}, **quiet)
    try:
        return "killed" if process.wait(limit) else "survived"
    except subprocess.TimeoutExpired:
        return "timeout"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def copied(folder: Path) -> Path:
    """A copy of the tree with its compiled kernels, which stay valid since the times of the files are kept."""
    names = subprocess.check_output(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, text=True).splitlines()
    for file in [*map(ROOT.joinpath, names), *(ROOT / PACKAGE).rglob("*.nb[ic]")]:
        target = folder / file.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(file, target)
    return folder


Trial = tuple[str, str, str, bool, list[str]]
"""path, text, mutated text, whether a kernel may hold the change, and tests"""


def outcome(copy: Path, trial: Trial, limit: float) -> str:
    """What the tests of a file's room say to a mutant. Kernels that may hold it are compiled anew."""
    path, text, mutated, compiled, tests = trial
    files = [copy / one for one in (importers(path) if compiled else ())]

    def kernels() -> list[Path]:
        return [kernel for one in files for kernel in one.parent.glob(f"__pycache__/{one.stem}.*.nb[ic]")]

    kept, file = [kernel.rename(f"{kernel}.kept") for kernel in kernels()], copy / path
    time_ns = file.stat().st_mtime_ns
    file.write_text(mutated)
    try:
        return run_tests(copy, tests, limit)
    finally:
        file.write_text(text)
        os.utime(file, ns=(time_ns, time_ns))
        for kernel in kernels():
            kernel.unlink()
        for kernel in kept:
            kernel.rename(kernel.with_suffix(""))


def mutants(paths: list[str]) -> list[dict[str, Any]]:
    """All mutants of the files: where they are, what is changed, and the trial."""
    files = {file for one in map(Path, paths) for file in (one.rglob("*.py") if one.is_dir() else [one])}
    found = []
    for path in sorted(str(file.resolve().relative_to(ROOT)) for file in files):
        text, tests, source = (ROOT / path).read_text(), tests_of(path), (ROOT / path).read_bytes()
        for (begin, end, new, kind), compiled in changes(text).items():
            mutated, line = (source[:begin] + new + source[end:]).decode(), source[:begin].count(b"\n") + 1
            trial = path, text, mutated, compiled, tests
            found.append({"where": f"{path}:{line}", "kind": kind, "trial": trial})
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("paths", nargs="*", default=[PACKAGE])
    parser.add_argument("--sample", type=int, metavar="N", help="so many at random (default: all)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "runs/mutants.jsonl")
    chosen = parser.parse_args()
    found = mutants(chosen.paths)
    if chosen.sample is not None and chosen.sample < len(found):
        found = sorted(random.Random(chosen.seed).sample(found, chosen.sample), key=lambda one: str(one["where"]))
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    limits = {}
    for tests in sorted({tuple(sorted(one["trial"][-1])) for one in found}):
        begin = time.monotonic()
        if run_tests(ROOT, list(tests)) != "survived":
            sys.exit(f"without a mutation, a test fails of {' '.join(tests)}")
        limits[tests] = 60 + 4 * (time.monotonic() - begin)
    with tempfile.TemporaryDirectory() as folder, chosen.out.open("w") as results, ThreadPoolExecutor(2) as pool:
        copies = queue.SimpleQueue[Path]()
        for name in ("first", "second"):
            copies.put(copied(Path(folder) / name))

        def tried(mutant: dict[str, Any]) -> dict[str, Any]:
            trial = mutant.pop("trial")
            diff = difflib.unified_diff(*(text.splitlines() for text in trial[1:3]), n=0, lineterm="")
            mutant["diff"] = [*diff][3:]
            copy, begin = copies.get(), time.monotonic()
            mutant["outcome"] = outcome(copy, trial, limits[tuple(sorted(trial[-1]))])
            mutant["seconds"] = round(time.monotonic() - begin, 1)
            copies.put(copy)
            print(json.dumps(mutant), file=results, flush=True)
            return mutant

        survivors = 0
        try:
            for i, one in enumerate(pool.map(tried, found), 1):
                print(f"{i}/{len(found)} {one['outcome']} {one['seconds']} s: {one['where']} {one['kind']}", flush=True)
                if one["outcome"] == "survived":
                    survivors += 1
                    print(*one["diff"], sep="\n", flush=True)
        finally:
            pool.shutdown(cancel_futures=True)  # what was interrupted does not try the rest
    print(f"{len(found) - survivors} of {len(found)} mutants are killed")


if __name__ == "__main__":
    main()
