"""Feed every parser damaged files: `python benchmarks/fuzz.py --inputs 100000 --only map-png --engine random`.

For any bytes, the outcome must be a result or an InputError of one line, in bounded time and memory. Everything else is
a fault, Python's warnings included. `--engine atheris` (the optional extra `fuzz`) is guided by coverage; `--engine
random` has no dependencies.
"""

from __future__ import annotations

import argparse
import faulthandler
import importlib.util
import json
import os
import random
import re
import resource
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from bags import compile_once
from parsers import PARSERS, Parser

import sixthsense
from sixthsense.config.errors import InputError

LONGEST_S = 10.0
LONGEST_LINE = 2000  # characters of an error message
LARGEST_MB = 3000
_KEPT_FAULTS = 20
_INSTRUMENTED = ["sixthsense", "rosbags", "mcap", "tomllib", "yaml", "PIL"]
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
_NUMBERS = [b"nan", b"-nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e999", b"5e-324", b"0", b"-0.0", b"-1", b"1e30",
            b"9" * 30, b"9" * 5000, b"0x" + b"f" * 5000, b"true", b"''", b"[]", b".nan", b"1_0"]  # fmt: skip
_NESTS = [b"[", b"{", b"(", b"{a=", b"a.", b"[a,", b"- ", b"'", b'"', b"\n", b" ", b"9", b"&a [*a,"]
_WORDS = [b'"a\\nb" = 1\n', b'"a\\nb": 1\n', b"\n[a.b]\n", b"\x00", b"\\u0000", b"\\n", b"\r", b"\x0b", b"\xc2\x85",
          b"\xe2\x80\xa8", b"\xff\xfe", b"\xed\xa0\x80", b"[[", b"]]", b"#", b"&a", b"*a", b"!!null "]  # fmt: skip
_BINARY = [b"\x00" * 4, b"\xff" * 4, b"\xff\xff\xff\x7f", b"\x00" * 8, b"\xff" * 8, struct.pack("<d", float("nan")),
           struct.pack("<d", float("inf")), struct.pack("<d", 1e308), struct.pack("<d", -1.0),
           struct.pack("<f", float("nan")), struct.pack("<f", 1e38), struct.pack("<I", 1 << 28)]  # fmt: skip


# Warnings that Python does not show by default.
_UNSEEN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)


class FaultError(Exception):
    """An outcome that must not happen for any input."""


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Damage a file in one to four places."""
    for _ in range(rng.randint(1, 4)):
        at = rng.randint(0, len(data))
        end = min(len(data), at + rng.choice((1, 2, 8, 50)))
        kind = rng.randrange(10)
        if kind == 0 and data:
            at = min(at, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + data[end:]
        elif kind == 2:
            data = data[:at] + rng.randbytes(rng.randint(1, 20)) + data[at:]
        elif kind == 3:
            data = data[:at]
        elif kind == 4:
            data = data[:end] + data[at:]
        elif kind == 5:
            word = rng.choice(_BINARY)
            data = data[:at] + word + data[at + len(word) :]
        elif kind == 6:
            data = data[:at] + rng.choice(_WORDS) + data[at:]
        elif kind == 7:
            data = data[:at] + rng.choice(_NESTS) * rng.choice((2, 100, 3000)) + data[at:]
        elif spans := [m.span() for m in _NUMBER.finditer(data[:20_000])]:
            low, high = rng.choice(spans)
            data = data[:low] + rng.choice(_NUMBERS) + data[high:]
    return data


def attempt(parser: Parser, folder: Path, data: bytes) -> bool:
    """Whether the bytes gave a result; FaultError for anything but a result or an error of one line."""
    began = time.perf_counter()
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            made = _outcome(parser, folder, parser.form(data))
        for warning in told:
            if not issubclass(warning.category, _UNSEEN):
                where = f"{Path(warning.filename).name}:{warning.lineno}"
                raise FaultError(f"{warning.category.__name__} at {where}: {str(warning.message)[:200]}")
        return made
    finally:
        if time.perf_counter() - began > LONGEST_S:
            raise FaultError(f"took {time.perf_counter() - began:.0f} s")


def _outcome(parser: Parser, folder: Path, content: bytes) -> bool:
    try:
        parser.read(folder, content)
        return True
    except InputError as error:
        line = str(error)
        if len(line.splitlines()) != 1 or len(line) > LONGEST_LINE:
            said = f"an error of {len(line.splitlines())} lines, {len(line)} characters: {line[:200]!r}"
            raise FaultError(said) from error
        return False
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)
        ours = next((f for f in reversed(where) if "sixthsense" in f.filename), where[-1])
        what = f"{type(error).__name__} at {Path(ours.filename).name}:{ours.lineno}: {str(error)[:200]}"
        raise FaultError(what) from error


class Tally:
    """Counts of the outcomes so far; ends the process after the last input or when the time is over."""

    def __init__(self, parser: Parser, folder: Path, inputs: int, minutes: float) -> None:
        self._parser, self._folder, self._inputs, self._longest_s = parser, folder, inputs, 60.0 * minutes
        self._results = self._refusals = self._count = 0
        self._faults: dict[str, int] = {}
        self._began = time.perf_counter()

    def __call__(self, data: bytes) -> None:
        """Try one input."""
        if not self._count % 100:  # ends a hang with a traceback; its input is still in the folder
            faulthandler.dump_traceback_later(100 * LONGEST_S, exit=True)
        self._count += 1
        try:
            if attempt(self._parser, self._folder, data):
                self._results += 1
            else:
                self._refusals += 1
            if _peak_mb() > LARGEST_MB and not any(what.startswith("memory") for what in self._faults):
                raise FaultError(f"memory: {_peak_mb():.0f} MB")
        except FaultError as fault:
            what = re.sub(r"\d{4,}|'.*'|0x\w+", "…", str(fault))[:120]
            if what not in self._faults and len(self._faults) < _KEPT_FAULTS:
                file = self._folder / f"fault-{len(self._faults)}"
                file.write_bytes(self._parser.form(data))
                print(f"{self._parser.name}: {fault}\n    input: {file}", file=sys.stderr, flush=True)
            self._faults[what] = self._faults.get(what, 0) + 1
        if self._count == self._inputs or time.perf_counter() - self._began > self._longest_s:
            self._leave()

    def _leave(self) -> None:
        told = {
            "inputs": self._count, "results": self._results, "refusals": self._refusals,
            "faults": sum(self._faults.values()), "seconds": time.perf_counter() - self._began, "peak_mb": _peak_mb(),
        }  # fmt: skip
        (self._folder / "tally.json").write_text(json.dumps(told))
        sys.stderr.flush()
        os._exit(0)  # the engine would continue


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _work(parser: Parser, folder: Path, options: argparse.Namespace) -> None:
    """Fuzz one parser; runs in its own process."""
    seeds = parser.seeds(folder)
    if options.engine == "atheris":
        _work_with_atheris(parser, folder, options, seeds)
    _read_all(parser, folder, seeds)
    tally, rng = Tally(parser, folder, options.inputs, options.minutes), random.Random(options.seed)
    while True:
        tally(rng.randbytes(rng.randint(0, 300)) if rng.random() < 0.05 else mutate(rng.choice(seeds), rng))


def _read_all(parser: Parser, folder: Path, seeds: list[bytes]) -> None:
    """Read all valid inputs, which imports and compiles everything."""
    for valid in seeds:
        parser.read(folder, parser.form(valid))
    if "rosbags" in sys.modules:
        compile_once()


def _work_with_atheris(parser: Parser, folder: Path, options: argparse.Namespace, seeds: list[bytes]) -> None:
    import atheris

    # Functions compiled by Numba must not be instrumented.
    package = Path(sixthsense.__file__).parent
    sources = {file: ".".join(file.relative_to(package.parent).with_suffix("").parts) for file in package.rglob("*.py")}
    compiled = [name for file, name in sources.items() if "numba.njit" in file.read_text()]
    with atheris.instrument_imports(include=_INSTRUMENTED, exclude=compiled):
        for name in list(sys.modules):  # making the seeds has imported some
            if name.partition(".")[0] in _INSTRUMENTED and name not in ("sixthsense.config.errors", *compiled):
                del sys.modules[name]
        _read_all(parser, folder, seeds)
    corpus = folder / "corpus"
    corpus.mkdir()
    for k, valid in enumerate(seeds):
        (corpus / str(k)).write_bytes(valid)
    tally = Tally(parser, folder, options.inputs, options.minutes)

    def custom(data: bytes, longest: int, number: int) -> bytes:
        # A third is mutated by the random engine, a third by it from a valid seed: inputs of the corpus have often been
        # mutated so much that parsers reject them early.
        rng = random.Random(number)
        kind = rng.randrange(3)
        if kind == 0:
            return atheris.Mutate(data, longest)
        return mutate(data if kind == 1 else rng.choice(seeds), rng)[:longest]

    longest = 2 * max(map(len, seeds)) + 8000
    flags = [f"-max_len={longest}", f"-seed={options.seed + 1}", "-timeout=1000", "-rss_limit_mb=0", "-verbosity=0"]
    atheris.Setup([sys.argv[0], str(corpus), *flags], tally, custom_mutator=custom)
    atheris.Fuzz()


def _feed(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """The row of one parser in the table; its folder is kept if there was a fault."""
    folder = Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-"))
    words = ["--worker", str(folder), "--only", name, "--engine", options.engine]
    for key in ("inputs", "minutes", "seed"):
        words += [f"--{key}", str(getattr(options, key))]
    child = subprocess.run([sys.executable, __file__, *words], stdout=subprocess.DEVNULL)
    try:
        row: dict[str, Any] = json.loads((folder / "tally.json").read_text())
    except FileNotFoundError:
        print(f"{name}: the process ended with {child.returncode}; its last input is in {folder}", file=sys.stderr)
        return dict.fromkeys(("inputs", "results", "refusals", "seconds", "peak_mb"), float("nan")) | {"faults": 1}
    if not row["faults"]:
        shutil.rmtree(folder)
    return row


def main() -> int:
    atheris = importlib.util.find_spec("atheris") is not None
    cli = argparse.ArgumentParser(description=__doc__)
    cli.add_argument("--inputs", type=int, default=100_000, help="per parser")
    cli.add_argument("--minutes", type=float, default=60.0, help="per parser, at most")
    cli.add_argument("--only", action="append", choices=[*PARSERS], help="may be given several times")
    cli.add_argument("--engine", choices=("atheris", "random"), default="atheris" if atheris else "random")
    cli.add_argument("--seed", type=int, default=0)
    cli.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    options = cli.parse_args()
    if options.worker:
        _work(PARSERS[options.only[0]], options.worker, options)
    print(f"engine: {options.engine}\n")
    print("| parser | inputs | results | refusals | faults | seconds | peak memory, MB |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    faults = 0
    for name in options.only or PARSERS:
        row = _feed(name, options)
        counts = " | ".join(str(row[key]) for key in ("inputs", "results", "refusals", "faults"))
        print(f"| {name} | {counts} | {row['seconds']:.0f} | {row['peak_mb']:.0f} |", flush=True)
        faults += row["faults"]
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
