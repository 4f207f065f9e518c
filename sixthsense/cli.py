"""The command line: a shell around the library; the only place that prints or exits."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from sixthsense.config import Config, ConfigError, load_config, preset

if TYPE_CHECKING:
    from sixthsense.folder import RunFolder
    from sixthsense.source import Tick
    from sixthsense.trace import Trace

T = TypeVar("T")

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


class UsageError(ValueError):
    """One line for a command line that will not do."""


@dataclass(frozen=True)
class Common:
    """Options that every command with a run folder has."""

    config_file: Annotated[Path | None, tyro.conf.arg(name="config")] = None
    """TOML file, partial or whole, over the preset; a run folder's config.toml repeats that run."""
    out: Path | None = None
    """Folder to write; by default a new one under runs/."""
    overwrite: bool = False
    """Replace the folder if it exists."""
    settings: Annotated[Config, tyro.conf.arg(name="")] = field(default_factory=Config)


@dataclass(frozen=True)
class Run(Common):
    """Put a robot into a scene it has never seen and let it reach its goals."""

    scene_name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")] = None
    """A shipped scene's name or a file: .toml, map_server .yaml, or .scn."""
    realtime: bool = False
    """Hold the simulated clock back to the wall's."""


@dataclass(frozen=True)
class Replay(Common):
    """Digest a recorded log: CARMEN .log or .clf, plain, .gz or .bz2."""

    log: Annotated[Path, tyro.conf.Positional] = Path()
    """The log."""
    relations: Path | None = None
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
    except ValueError as error:
        # Every complaint about what the user gave us is a ValueError of one line.
        if not isinstance(error, _bad_input()):
            raise
        print(f"sixthsense: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("sixthsense: interrupted", file=sys.stderr)
        return INTERRUPTED


def _bad_input() -> tuple[type[ValueError], ...]:
    from sixthsense.folder import FolderError
    from sixthsense.logs import LogError
    from sixthsense.scene import SceneError

    return UsageError, ConfigError, SceneError, LogError, FolderError


def _parse(command: type[T], args: list[str], name: str, default: Any = None) -> T:
    """Parse words into a command's options; UsageError, one line, for what it does not understand."""
    help_wanted = any(word in ("-h", "--help") for word in args)
    errors = io.StringIO()
    try:
        with contextlib.nullcontext() if help_wanted else contextlib.redirect_stderr(errors):
            options: T = tyro.cli(command, prog=f"sixthsense {name}", args=args, default=default)
            return options
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        raise UsageError(_one_line(errors.getvalue())) from None


def _one_line(message: str) -> str:
    """The gist of a parser's framed, wrapped message."""
    rows = [row.strip(" │╭╮╰╯─-").strip() for row in message.splitlines()]
    body: list[str] = []
    for row in rows[1:]:
        if row.startswith(("Argument helptext", "For full helptext", "Perhaps you meant", "Arguments similar")):
            break
        if row:
            body.append(row)
    line = re.sub(r"\s+", " ", " ".join(body))
    return re.sub(r"^Error parsing (\S+): \1", r"\1", line) or "the command line was not understood"


def _resolve(command: type[T], args: list[str], name: str, base: str) -> T:
    """Options with their precedence: defaults < preset < configuration file < flags."""
    first: Any = _parse(command, args, name)
    named = _given("--preset", args)
    settings = preset(first.settings.preset if named else base) if named or base != "default" else None
    if first.config_file is not None:
        settings = load_config(first.config_file, settings if named else None)
    default = dataclasses.replace(first, settings=settings or preset())
    return _parse(command, args, name, default)


def _run(args: list[str]) -> int:
    options = _resolve(Run, args, "run", "default")
    config = options.settings
    if options.scene_name is not None:
        config = dataclasses.replace(config, scene=options.scene_name)
    if config.goal is not None and not _given("--task", args):
        config = dataclasses.replace(config, task="goal")
    if Path(config.scene).suffix:
        # The run can then be repeated from its configuration wherever one stands.
        config = dataclasses.replace(config, scene=str(Path(config.scene).resolve()))
    from sixthsense.run import mission, run, warm_up
    from sixthsense.scene import load_scene

    scene = load_scene(config.scene)
    mission(scene, config)
    folder = _folder(options, config, f"{scene.name}-{config.estimator}")
    _announce_compilation()
    warm_up()
    with _Progress(f"{scene.name}, {config.task}", config.max_time, options.realtime) as progress:
        trace = run(config, progress)
    title = f"{scene.name} · {config.estimator} · {config.preset} · seed {config.seed}: {trace.outcome}"
    return _finish(folder, trace, title)


def _replay(args: list[str]) -> int:
    options = _resolve(Replay, args, "replay", "intel")
    config = options.settings
    from sixthsense.logs import open_log
    from sixthsense.logs.carmen import read_relations
    from sixthsense.run import replay, warm_up

    relations = read_relations(options.relations) if options.relations is not None else None
    log = open_log(options.log, config.laser)
    if log.backward_stamps:
        note = f"note: {options.log.name}: stamps run backwards at {log.backward_stamps} scans; replayed in file order"
        print(note, file=sys.stderr)
    folder = _folder(options, config, f"{options.log.name.split('.')[0]}-{config.estimator}")
    _announce_compilation()
    warm_up()
    with _Progress(options.log.name, log.duration_s, False) as progress:
        trace = replay(log, config, relations, progress)
    return _finish(folder, trace, f"{options.log.name} · {config.estimator}: {trace.outcome}")


def _scenes(args: list[str]) -> int:
    if args and args[0] in ("-h", "--help"):
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


def _given(flag: str, args: list[str]) -> bool:
    return any(word == flag or word.startswith(flag + "=") for word in args)


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

    def __call__(self, tick: Tick) -> None:
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
