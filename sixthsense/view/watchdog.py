"""Starts a program and ends it when the process that asked for it is gone, whatever has ended that.

Run as a program of its own: `python watchdog.py PROGRAM ARGUMENT ...`. Its standard input is a pipe from the process
that asked, which the operating system closes when the process ends. Before an end in order that process can write
`stay`.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from typing import Any

STAY = b"stay"
TIMEOUT_S = 5.0
"""until a program that was asked to end is killed"""


def end(process: subprocess.Popen[Any]) -> None:
    """Ask a process to end, and kill it if it does not."""
    process.terminate()
    try:
        process.wait(TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()


def main(command: list[str]) -> int:
    """Keep a program until standard input is closed; returns its exit code."""
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL)

    def watch() -> None:
        if sys.stdin.buffer.read() != STAY:
            end(process)

    threading.Thread(target=watch, daemon=True).start()
    return process.wait()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
