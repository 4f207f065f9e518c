"""Common parts of the commands: options, the run's folder, the live view, and the summary at the end."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from sixthsense.cli import DONE, EXIT_CODES, EXIT_CODES_OF_MAPS, FAILED
from sixthsense.cli.options import Arg, Options, Parser, Table, as_options, parse
from sixthsense.cli.options import with_options as with_options
from sixthsense.config import Config, load_config, notes_of, preset
from sixthsense.config.errors import InputError
from sixthsense.config.files import read_table
from sixthsense.config.parts import import_named
from sixthsense.config.section import shown
from sixthsense.loop.interrupt import is_command_ended

if TYPE_CHECKING:
    from sixthsense.figures.run import Run
    from sixthsense.loop.run import OnTick
    from sixthsense.navigation.unseen_places import UnseenPlace


class WithSettings(Options):
    """Options of all commands that take the fields of the configuration."""

    takes_fields: ClassVar[bool] = True

    config: Annotated[Path | None, Arg("FILE")] = None
    """TOML file of settings, which override the preset. It may be partial; that of a run folder repeats the run."""
    parts: Annotated[Path | None, Arg("DIR")] = None
    """Folder to search for parts of your own, also for those that only a file names. A part is code that is run."""
    settings: Config = Config()

    @classmethod
    def start(cls, given: Table) -> str | Config:
        """The preset or the complete configuration that file and flags change, from a command's own options."""
        return cls.base


class OfScene(WithSettings):
    """Options of the commands that simulate a robot."""

    scene: Annotated[str | None, Arg("[SCENE]", is_positional=True)] = None
    """Shipped scene, or a .toml or map_server .yaml file."""


class Common(WithSettings):
    """Options of all commands that write a run folder."""

    out: Annotated[Path | None, Arg("DIR")] = None
    """Folder to write; by default a new one under runs/."""
    overwrite: bool = False
    """Replace the folder if it exists."""
    view: Annotated[str | None, Arg("[WHERE]", without="window")] = None
    """Live view in Rerun: window, browser or FILE.rrd. Needs the extra view: pip install -e '.[view]'."""
    verbose: bool = False
    """Print all metrics at the end."""
    strict: bool = False
    """End with exit code 3 if the map is doubtful, with 4 if it is broken."""

    def started(self, run: Callable[..., Run], stem: str, *args: Any, hook: OnTick | None = None, **given: Any) -> int:
        """Make a run in the folder that is given, or in a new one under runs/ whose name begins with `stem`.

        What it has come to is printed; returns the exit code.
        """
        from sixthsense.loop.run import combined_hooks
        from sixthsense.record.writing import FolderInUseError

        with live_view(self.view) as view:
            on_tick = combined_hooks(hook, view)
            while True:
                out = self.out or next(numbered(stem))
                try:
                    return show_end(run(*args, on_tick=on_tick, out=out, overwrite=self.overwrite, **given), self)
                except FolderInUseError:  # a run that started at the same moment has taken the new one
                    if self.out is not None:
                        raise


class WithPriorMap(Common):
    """Options of the commands that can begin with the map of an earlier run."""

    prior_map: Annotated[Path | None, Arg("DIR")] = None
    """Earlier run whose map this one begins with. The folder of a run in the same building."""
    pose: Annotated[tuple[float, float, float] | None, Arg("X Y THETA")] = None
    """With --prior-map: start in its frame, m and rad. By default the start of the scene or log."""
    pose_sigma: Annotated[tuple[float, float, float] | None, Arg("SX SY ST")] = None
    """With --prior-map: sigmas of that pose, m and rad. 0 by default: known exactly."""
    lost: bool = False
    """With --prior-map: the robot does not know where it is. It drives until it has found out."""

    def prior(self) -> dict[str, Any]:
        """The prior map and the start in it as calls take them; InputError if the configuration alone has one."""
        if self.prior_map is None and self.config is not None and "prior_map" in notes_of(self.config):
            raise InputError("config", f"{self.config} is of a run with a prior map", "with `prior_map`")
        return {name: getattr(self, name) for name in ("prior_map", "pose", "pose_sigma", "lost")}


def read_command(command: type[Options], parser: Parser, words: Sequence[str]) -> tuple[Options, Table]:
    """Parse a command's words into its options, and the table of the Config fields that were set by flags.

    Precedence is defaults < preset < configuration file < flags; a file that names a preset is read over that. A part
    that a flag names may lie in the working folder. Raises InputError for two presets, and one that names the flag, or
    the file and its field.
    """
    given, flags = parse(parser, words)
    import_named({**flags, **given}, given.get("parts"))
    own = command(**given)
    if not isinstance(own, WithSettings):
        return own, flags
    from sixthsense.api import configured  # here, since the help need not wait for it

    base = _base(own.start(given), own.config, flags.get("preset"))
    if "parts" in given:
        import_named(dict(base), given["parts"])
    changed = flags.keys() - {"preset"} | {"scene"}
    fields = {name: value for name, value in {**flags, **given}.items() if name in changed}
    return own.replaced(settings=configured(base, fields)), flags


def _base(start: str | Config, file: Path | None, name: str | None) -> Config:
    """The configuration that the flags change, from where the command starts, a file, and a preset's name."""
    base = start if isinstance(start, Config) and name is None else preset(name or str(start))
    if file is None:
        return base
    named = read_table(file).get("preset")
    if named is not None and name not in (None, named):
        raise InputError("preset", f"found {shown(name)} with {file}, which names {shown(named)}", "one of the two")
    return load_config(file, base if named is None else None)


def numbered(stem: str) -> Iterator[Path]:
    """The unused paths runs/STEM-NUMBER, the lowest number first."""
    for number in itertools.count(1):
        out = Path("runs") / f"{stem}-{number}"
        if not os.path.lexists(out) and not os.path.lexists(out.with_name(out.name + ".partial")):
            yield out


@contextlib.contextmanager
def live_view(target: str | None) -> Iterator[OnTick | None]:
    """The hook of `--view`, None without a target; a browser view stays open after the run until Ctrl-C."""
    if target is None:
        yield None
        return
    from sixthsense.view.recording import View

    with View(target) as view:
        if view.page:
            announce(f"view: {view.page}")
        yield view
        view.finish()
        if view.page and not is_command_ended():
            announce("the view stays open until Ctrl-C")
            with contextlib.suppress(KeyboardInterrupt):
                view.wait()


class Announcer(logging.Handler):
    """Prints what is logged."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print the message of a record."""
        announce(record.getMessage())


@contextlib.contextmanager
def announced() -> Iterator[None]:
    """Print what the package logs in the block."""
    log, prints = logging.getLogger("sixthsense"), Announcer()
    level = log.level
    log.addHandler(prints)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.setLevel(level)
        log.removeHandler(prints)


def announce(line: str) -> None:
    """Print a status line to stderr."""
    print(as_options(line), file=sys.stderr)


def show_end(run: Run, options: Common) -> int:
    """Print what a run has come to, in at most ten lines, and before it all metrics if wanted; returns the exit code.

    The places that an exploration has left unseen are listed with the metrics. If it is strict, a run whose map is
    doubtful or broken has an exit code of its own where it would have ended well.
    """
    lines, left = dict(run.summary), run.trace.left
    if options.verbose:
        print(run.metrics, *(f"left unseen: {_described(place)}" for place in left), "", sep="\n")
    if left:
        places = f"{len(left)} place{'s' * (len(left) > 1)}, {sum(place.area_m2 for place in left):.2g} m²"
        lines["left unseen"] = f"{places}, the largest {left[0].reason}{_behind(left[0])}; --verbose lists them"
    folder = Path(run.folder or "")
    files = [str(folder / name) for name in ("map.png", "map.yaml") if (folder / name).exists()]
    lines |= {"files": ", ".join(files)} if files else {}
    lines["report"] = f"sixthsense report {shlex.quote(str(folder))} writes figures/report.html"
    print(*(f"{label:12} {as_options(text)}" for label, text in lines.items()), f"written to {run.folder}/", sep="\n")
    code = EXIT_CODES.get(run.outcome, FAILED)
    if options.strict and code == DONE and run.verdict is not None:
        return EXIT_CODES_OF_MAPS[run.verdict.level]
    return code


def _behind(place: UnseenPlace) -> str:
    return "" if place.gap_m is None else f" behind a gap of {place.gap_m:.2f} m"


def _described(place: UnseenPlace) -> str:
    return f"({place.x:.2f}, {place.y:.2f}) {place.area_m2:.2g} m², {place.reason}{_behind(place)}"
