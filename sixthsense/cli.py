"""The command line: a shell around the library; the only place that prints or exits."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import time
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

from sixthsense.config import Config, load_config, merge, preset
from sixthsense.errors import InputError
from sixthsense.options import Table, UsageError, parse

if TYPE_CHECKING:
    from sixthsense.folder import RunFolder
    from sixthsense.logs.carmen import CarmenLog, Relations
    from sixthsense.source import Tick
    from sixthsense.trace import Trace

C = TypeVar("C", bound="Common")

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
EXIT_CODES = {"goal reached": DONE, "tour ended": DONE, "log ended": DONE, "interrupted": INTERRUPTED}

USAGE = """\
usage: sixthsense COMMAND ...

A workbench for 2-D laser SLAM.

commands:
  run [SCENE]    put a robot into a scene and let it reach its goals
  replay LOG     digest a real robot's log with the same code
  scenes         list the scenes that ship

`sixthsense COMMAND --help` lists a command's options.
"""


@dataclass(frozen=True)
class Common:
    """Options that every command with a run folder has."""

    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """TOML file, partial or whole, over the preset; a run folder's config.toml repeats that run."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder to write; by default a new one under runs/."""
    overwrite: bool = False
    """Replace the folder if it exists."""
    settings: Annotated[Config, tyro.conf.arg(name="")] = field(default_factory=Config)


@dataclass(frozen=True)
class Run(Common):
    """Put a robot into a scene it has never seen and let it reach its goals."""

    scene: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[SCENE]")] = None
    """A shipped scene's name or a file: .toml, map_server .yaml, or .scn."""
    realtime: bool = False
    """Hold the simulated clock back to the wall's."""


@dataclass(frozen=True)
class Replay(Common):
    """Digest a recorded log: CARMEN .log or .clf, plain, .gz or .bz2."""

    log: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")] = None
    """The log."""
    relations: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Hand-checked relations between poses (Kuemmerle et al. 2009) to measure the trajectory against."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 1 the robot failed, 2 bad input, 130 interrupted."""
    args = list(sys.argv[1:] if argv is None else argv)
    if not args or args[0] in ("-h", "--help"):
        print(USAGE, end="")
        return DONE if args else BAD_INPUT
    commands: dict[str, Callable[[list[str]], int]] = {"run": _run, "replay": _replay, "scenes": _scenes}
    try:
        if args[0] not in commands:
            raise UsageError(f"command: found {args[0]!r}, allowed: {', '.join(commands)}")
        return commands[args[0]](args[1:])
    except BrokenPipeError:
        return FAILED
    except InputError as error:
        return _complain(str(error))
    except OSError as error:
        return _complain(f"{error.filename or 'output'}: {error.strerror or error}")
    except KeyboardInterrupt:
        print("sixthsense: interrupted", file=sys.stderr)
        return INTERRUPTED


def _complain(message: str) -> int:
    print(f"sixthsense: {' '.join(message.split())}", file=sys.stderr)
    return BAD_INPUT


def _help(command: type[Common], name: str, base: str) -> int:
    """Print a command's options, with the values they have by default."""
    with contextlib.suppress(SystemExit):
        tyro.cli(command, prog=f"sixthsense {name}", args=["--help"], default=command(settings=preset(base)))
    return DONE


def _parse(command: type[C], place: str, base: str, args: list[str]) -> tuple[C, Table]:
    """A command's options, and the table of those fields of Config that flags set.

    `place` names the option that stands by itself, `base` the preset where none is named. Precedence is defaults <
    preset < configuration file < flags; a ConfigError names the flag, or the file and its field.
    """
    own = {name: hint for name, hint in typing.get_type_hints(command).items() if name not in ("settings", place)}
    given, table = parse(args, own, place)
    settings = preset(table.get("preset", base))
    if "config" in given:
        settings = load_config(given["config"], settings if "preset" in table else None, base)
    return command(**given, settings=merge(settings, table, "--")), table


def _run(args: list[str]) -> int:
    if _wants_help(args):
        return _help(Run, "run", "default")
    options, flags = _parse(Run, "scene", "default", args)
    config = options.settings
    if options.scene is not None:
        config = dataclasses.replace(config, scene=options.scene)
    if flags.get("goal") is not None and "task" not in flags:
        config = dataclasses.replace(config, task="goal")
    if Path(config.scene).suffix:
        # The run can then be repeated from its configuration wherever one stands.
        config = dataclasses.replace(config, scene=str(Path(config.scene).resolve()))
    from sixthsense.loop import mission, run, warm_up
    from sixthsense.scene import load_scene

    scene = load_scene(config.scene)
    mission(scene, config)
    label = f"{scene.name}, {config.task}"
    with _folder(options, config, f"{scene.name}-{config.estimator}") as folder:
        _announce_compilation()
        warm_up()
        with _Progress(label, config.max_time, options.realtime) as progress:
            trace = run(config, progress)
        title = f"{scene.name} · {config.estimator} · {config.preset} · seed {config.seed}: {trace.outcome}"
        return _finish(folder, trace, title)


def _replay(args: list[str]) -> int:
    if _wants_help(args):
        return _help(Replay, "replay", "intel")
    options, flags = _parse(Replay, "log", "intel", args)
    config = options.settings
    for name in ("scene", "task", "goal", "start", "region", "planner", "follow", "world"):
        if name in flags:
            raise UsageError(f"--{name}: found on replay, allowed: options of what a log leaves open, not of the robot")
    if options.log is None:
        raise UsageError("log: found nothing, allowed: a CARMEN file")
    from sixthsense.logs import open_log
    from sixthsense.logs.carmen import read_relations
    from sixthsense.loop import replay, warm_up

    relations = read_relations(options.relations) if options.relations is not None else None
    log = open_log(options.log, config.laser)
    if relations is not None:
        _check_relations(relations, log, options)
    name = Path(options.log).name
    if log.backward_stamps:
        note = f"note: {name}: stamps run backwards at {log.backward_stamps} scans; replayed in file order"
        print(note, file=sys.stderr)
    with _folder(options, config, f"{name.split('.')[0]}-{config.estimator}") as folder:
        _announce_compilation()
        warm_up()
        with _Progress(name, log.duration_s, False) as progress:
            trace = replay(log, config, relations, progress)
        return _finish(folder, trace, f"{name} · {config.estimator}: {trace.outcome}")


def _check_relations(relations: Relations, log: CarmenLog, options: Replay) -> None:
    """Raise UsageError for a relation that names no scan of the log."""
    import numpy as np

    from sixthsense.metrics import relations_error

    stamps = np.array([t.log_stamp_s for t in log.ticks if t.scan is not None], dtype=np.float64)
    try:
        relations_error(stamps, np.zeros((len(stamps), 3)), relations.stamps, relations.poses)
    except ValueError as error:
        raise UsageError(f"{options.relations}: {error}, allowed: stamps of scans in {options.log}") from None


def _scenes(args: list[str]) -> int:
    if _wants_help(args):
        print("usage: sixthsense scenes\n\nList the scenes that ship.")
        return DONE
    if args:
        raise UsageError(f"scenes: found {args[0]!r}, allowed: no further words")
    from sixthsense.scene import load_scene, shipped_scenes

    for name in shipped_scenes():
        scene = load_scene(name)
        x0, y0, x1, y1 = scene.region
        size = f"{x1 - x0:.0f} x {y1 - y0:.0f} m"
        print(f"{name:10}  {size:>10}  {len(scene.walls):3d} walls  {len(scene.tour):2d} goals on the tour")
    return DONE


def _wants_help(args: list[str]) -> bool:
    return "-h" in args or "--help" in args


def _folder(options: Common, config: Config, stem: str) -> RunFolder:
    from sixthsense.folder import RunFolder

    if options.out is not None:
        return RunFolder(options.out, config, options.overwrite)
    number = 1
    while (out := Path("runs") / f"{stem}-{number}").exists() or out.with_name(out.name + ".partial").exists():
        number += 1
    return RunFolder(out, config)


def _announce_compilation() -> None:
    """Say in one line why a first run does not start at once."""
    import numba

    cache: str = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    folder = Path(cache) if cache else Path(__file__).parent
    if not any(folder.rglob("*.nbi")):
        print("compiling the hot loops, once; this takes about half a minute ...", file=sys.stderr)


def _finish(folder: RunFolder, trace: Trace, title: str) -> int:
    """Write the folder, print the table, and say how it ended."""
    from sixthsense.plot import save_map

    metrics = folder.write(trace)
    save_map(trace, folder.partial / "figures" / "map.png", title)
    folder.finish()
    width = max(map(len, metrics))
    for key, value in metrics.items():
        print(f"{key:{width}}  {value:.4g}" if isinstance(value, float) else f"{key:{width}}  {value}")
    print(f"written to {folder.out}/")
    return EXIT_CODES.get(trace.outcome, FAILED)


class _Progress:
    """A progress bar over the source's time, silent when not a terminal; with `realtime` it also holds the clock."""

    def __init__(self, label: str, total_s: float, realtime: bool) -> None:
        self._label = label
        self._total_s = total_s
        self._realtime = realtime
        self._first_ns: int | None = None
        self._shown_s = 0.0
        self._began = 0.0

    def __enter__(self) -> _Progress:
        from tqdm import tqdm

        form = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f} of {total:.0f} s, {elapsed} so far"
        self._bar = tqdm(total=self._total_s, desc=self._label, disable=None, leave=False, bar_format=form)
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def __call__(self, tick: Tick, trace: Trace) -> None:
        if self._first_ns is None:
            self._first_ns, self._began = tick.stamp_ns, time.monotonic()
        now_s = 1e-9 * (tick.stamp_ns - self._first_ns)
        if now_s - self._shown_s >= 0.1:
            self._bar.update(now_s - self._shown_s)
            self._shown_s = now_s
        if self._realtime:
            time.sleep(max(0.0, self._began + now_s - time.monotonic()))


if __name__ == "__main__":
    sys.exit(main())
