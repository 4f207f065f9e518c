"""The command line: a thin layer over the library, and the only package that prints or exits."""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from sixthsense.loop.interrupt import command_signals

if TYPE_CHECKING:
    from sixthsense.cli.options import Options

DONE, FAILED, BAD_INPUT, DOUBTFUL, BROKEN, INTERRUPTED = 0, 1, 2, 3, 4, 130
OUT_OF_MEMORY, DISK_FULL = 71, 74
"""EX_OSERR and EX_IOERR of sysexits.h"""
_GOOD_ENDS = (
    *("goal reached", "tour ended", "explored", "explored in part"),
    *("log ended", "time is up", "out of time", "ended by the user"),
)
EXIT_CODES = dict.fromkeys(_GOOD_ENDS, DONE) | {"interrupted": INTERRUPTED}
"""exit codes of a run's outcomes; every other outcome is a failure of the robot"""

EXIT_CODES_OF_MAPS = {"good": DONE, "unjudged": DONE, "doubtful": DOUBTFUL, "broken": BROKEN}
"""exit codes of a run that ends well, by the verdict on its map, where that is asked for"""

COMMANDS = {
    "run": ("runs", "[SCENE]", "simulate a robot that explores or drives to goals"),
    "replay": ("runs", "LOG", "process a real robot's log with the same code"),
    "live": ("network", "", "map with a robot on a ROS 2 network, and drive it"),
    "simulate": ("network", "[SCENE]", "a simulated robot on that network, to test with"),
    "merge": ("runs", "RUN_A RUN_B", "map two runs in one building together"),
    "calibrate": ("runs", "SCENE", "measure the robot's noise, for `run --config`"),
    "campaign": ("runs", "[SCENE ...]", "many runs on many processors, with a table"),
    "report": ("results", "RUN_DIR ...", "figures of runs, and a page"),
    "export": ("results", "RUN", "a bag, a graph, trajectories and tables of a run"),
    "audit": ("results", "ESTIMATE ...", "is a covariance as large as its errors?"),
    "scenes": ("listing", "[SCENE]", "list the shipped scenes, or describe one"),
    "parts": ("listing", "", "list what can be replaced: estimators, planners, ..."),
}
"""by name: the module of this package that has its class; arguments and purpose, a line of the usage"""

_OBJECTS_BETWEEN_COLLECTIONS = 100_000  # a run makes many objects and hardly a cycle: the default takes 8 % of its time

_USAGE = """\
usage: sixthsense COMMAND ...

A workbench for 2-D laser SLAM. First run: `sixthsense run apartment`.

commands:
{commands}

`sixthsense COMMAND --help` lists a command's options, `sixthsense --version`
tells the version. Exit codes: 0 done, 1 robot failed, 2 bad input, 130 Ctrl-C,
71 out of memory, 74 disk full; with --strict 3 map doubtful, 4 map broken.
"""


def usage() -> str:
    """The text of `sixthsense --help`, a line for each command."""
    lines = (f"  {f'{name} {arguments}':24}{purpose}" for name, (_, arguments, purpose) in COMMANDS.items())
    return _USAGE.format(commands="\n".join(lines))


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code.

    0: done; 1: the robot failed; 2: bad input; 3, 4: the map is doubtful, broken, where that is asked for; 71: out of
    memory; 74: the disk is full; 130, 143, 129: ended by Ctrl-C, SIGTERM, SIGHUP.
    """
    args, thresholds = list(sys.argv[1:] if argv is None else argv), gc.get_threshold()
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    with command_signals() as signals:
        try:
            code = _run(args)
        except BaseException as error:
            if not (isinstance(error, KeyboardInterrupt) or signals.has_raised):
                raise
            signals.is_over = True
            code = _report_error("interrupted", INTERRUPTED)
        signals.is_over, signals.is_last = True, argv is None
        gc.set_threshold(*thresholds)
        return signals.exit_code(_flushed(code))


def command_class(name: str) -> type[Options]:
    """The options of a command, with what it does."""
    found: type[Options] = getattr(import_module(f"sixthsense.cli.{COMMANDS[name][0]}"), name.capitalize())
    return found


def _run(args: list[str]) -> int:
    """Run one command. The usage loads no other module."""
    try:
        if not args or args[0] in ("-h", "--help"):
            print(usage(), end="")
            return DONE if args else BAD_INPUT
        if args[0] == "--version":
            from sixthsense.config.version import __version__

            print(f"sixthsense {__version__}")
            return DONE
        return _run_command(args[0], args[1:])
    except SystemExit:  # of the help
        return DONE
    except BrokenPipeError:
        return FAILED
    except MemoryError as error:
        return _report_error("; ".join(["out of memory", *getattr(error, "__notes__", ())]), OUT_OF_MEMORY)
    except OSError as error:
        code = DISK_FULL if error.errno == errno.ENOSPC else BAD_INPUT
        return _report_error(f"{error.filename or 'output'}: {error.strerror or error}", code)


def _run_command(name: str, words: list[str]) -> int:
    """Parse a command's words and run it; an error is reported in one line, with the options' names."""
    from sixthsense.config.errors import InputError, PartError, nearest

    common, parser = import_module("sixthsense.cli.common"), None
    try:
        if name not in COMMANDS:
            near = nearest(name, (*COMMANDS, "--help", "--version"))
            raise InputError("command", f"found {name!r}", ", ".join(COMMANDS), near)
        command = command_class(name)
        parser = import_module("sixthsense.cli.listing").parser_of(name, command)
        with common.announced():
            options, flags = common.read_command(command, parser, words)
            code: int = options.run(flags)
            return code
    except InputError as error:
        return _report_error(common.with_options(error, parser) if parser else str(error), BAD_INPUT)
    except PartError as error:
        return _report_error("; ".join([str(error), *getattr(error, "__notes__", ())]), FAILED)


def _report_error(message: str, code: int) -> int:
    with contextlib.suppress(OSError):  # of a terminal that has been closed
        print(f"sixthsense: {' '.join(message.split())}", file=sys.stderr)
    return code


def _flushed(code: int) -> int:
    """The exit code after all output is written; a reader that is gone must not make the interpreter fail at exit."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            code = code or FAILED
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return code
