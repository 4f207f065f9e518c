"""What the benchmarks share: timing in alternation, the machine, and figures as a table and as JSON."""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numba
import numpy as np
from threadpoolctl import threadpool_limits

from sixthsense.core.geometry import Array

T = TypeVar("T")
Figures = dict[str, float]


def arguments(description: str | None) -> argparse.ArgumentParser:
    """A parser with the options that every benchmark has."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as flat keys")
    return parser


def single_threaded() -> threadpool_limits:
    """A context in which BLAS runs on one thread."""
    return threadpool_limits(limits=1, user_api="blas")


def alternate(inputs: Iterable[T], *functions: Callable[[T], object]) -> Array:
    """Time functions in turn on each input, A B A B, so that a busy moment hits all alike.

    Returns (inputs, functions) milliseconds. Whatever must be compiled should have been.
    """
    rows = []
    for value in inputs:
        row = []
        for function in functions:
            began = time.perf_counter()
            function(value)
            row.append(1e3 * (time.perf_counter() - began))
        rows.append(row)
    return np.array(rows)


def machine() -> str:
    """Processor and versions, in one line."""
    info = Path("/proc/cpuinfo")
    rows = info.read_text().splitlines() if info.exists() else []
    models = [row.split(":")[1].strip() for row in rows if row.startswith("model name")]
    processor = f"{len(models)} x {models[0]}" if models else platform.processor() or platform.machine()
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}"
    return f"{processor}, {versions}, one BLAS thread"


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows in columns, the first row being the head: the first column flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        first, *rest = (cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join([first.strip().ljust(widths[0]), *rest]))


def print_figures(figures: Mapping[str, float], reach: Mapping[str, str]) -> None:
    """Print the machine, then each figure beside what it should reach."""
    print(machine())
    head = ("figure", "measured", "should reach")
    print_table([head, *((key, f"{value:.4g}", reach.get(key, "")) for key, value in figures.items())])


def write_json(file: Path | None, figures: Mapping[str, float]) -> None:
    """Write the figures, if a file was asked for."""
    if file is not None:
        file.write_text(json.dumps(figures, indent=2) + "\n")
