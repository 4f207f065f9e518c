"""Common parts of the commands: options, the run's folder, the live view, and the summary at the end."""

from __future__ import annotations

import contextlib
import itertools
import os
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from sixthsense.cli import DONE, EXIT_CODES, EXIT_CODES_OF_MAPS, FAILED
from sixthsense.cli.options import Arg, Options, Parser, Table, as_options, parse
from sixthsense.cli.options import with_options as with_options
from sixthsense.config import Config, load_config, preset, prior_map_of
from sixthsense.config.errors import InputError
from sixthsense.config.files import read_table
from sixthsense.config.parts import import_named
from sixthsense.config.section import shown
from sixthsense.config.tree import applied, with_checked_parts
from sixthsense.loop.interrupt import is_command_ended
from sixthsense.simulation.scene_files import scene_file
from sixthsense.view import VIEW_TARGETS, is_view_target

if TYPE_CHECKING:
    from sixthsense.figures.run import Run
    from sixthsense.loop.run import OnTick
    from sixthsense.navigation.unseen_places import UnseenPlace
    from sixthsense.record.folder import RunFolder
    from sixthsense.slam.prior_map import PriorStart


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

    def settings_of_scene(self) -> Config:
        """The configuration with the scene; InputError for one that does not exist."""
        config = self.settings if self.scene is None else self.settings.replaced(scene=self.scene)
        scene_file(config.scene)
        return config


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

    def prior_start(self) -> PriorStart | None:
        """The prior map and the start in it, if there is one; InputError for what is not allowed."""
        from sixthsense.record.store import prior_start

        if self.prior_map is None and self.config is not None and (note := prior_map_of(self.config)) is not None:
            found = f"{self.config} is of a run with the prior map {note.get('name')}"
            raise InputError("config", found, "with `prior_map`")
        return prior_start(self.prior_map, self.pose, self.pose_sigma, self.lost)


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
    from sixthsense.api import check_made  # here, since the help need not wait for it

    settings = _settings(own, given, flags)
    if "parts" in given:
        import_named(dict(settings), given["parts"])
    settings = with_checked_parts(settings)
    check_made(settings)
    return own.replaced(settings=settings), flags


def _settings(command: WithSettings, given: Table, flags: Table) -> Config:
    """The configuration from preset, file and flags."""
    start = command.start(given)
    settings = start if isinstance(start, Config) and "preset" not in flags else preset(flags.get("preset", start))
    if "config" in given:
        named = read_table(given["config"]).get("preset")
        if named is not None and flags.get("preset", named) != named:
            found = f"found {shown(flags['preset'])} with {given['config']}, which names {shown(named)}"
            raise InputError("preset", found, "one of the two")
        settings = load_config(given["config"], settings if named is None else None)
    fields = {name: value for name, value in flags.items() if name != "preset"}
    return applied(settings, fields, lambda note: announce(f"note: {note}"))


def run_folder(
    options: Common,
    config: Config,
    stem: str,
    replayed: Mapping[str, str] | None = None,
    prior: PriorStart | None = None,
) -> AbstractContextManager[RunFolder | None]:
    """The folder given by --out, or a new one under runs/ with a name that begins with `stem`."""
    from sixthsense.record.writing import FolderInUseError
    from sixthsense.running.runs import reserved

    out = options.out or next(numbered(stem))
    try:
        return reserved(out, config, options.overwrite, replayed, prior, announce)
    except FolderInUseError:  # a run that started at the same moment has taken it
        if options.out is not None:
            raise
        return run_folder(options, config, stem, replayed, prior)


def numbered(stem: str) -> Iterator[Path]:
    """The unused paths runs/STEM-NUMBER, the lowest number first."""
    for number in itertools.count(1):
        out = Path("runs") / f"{stem}-{number}"
        if not os.path.lexists(out) and not os.path.lexists(out.with_name(out.name + ".partial")):
            yield out


@contextlib.contextmanager
def live_view(options: Common) -> Iterator[tuple[OnTick, ...]]:
    """The hooks of `--view`, none without the option; a browser view stays open after the run until Ctrl-C."""
    if options.view is None:
        yield ()
        return
    if not is_view_target(options.view):
        raise InputError("view", f"found {shown(options.view)}", VIEW_TARGETS)
    from sixthsense.view.recording import View

    with View(options.view) as view:
        if view.page:
            announce(f"view: {view.page}")
        yield (view,)
        view.finish()
        if view.page and not (view.is_interrupted or is_command_ended()):
            announce("the view stays open until Ctrl-C")
            with contextlib.suppress(KeyboardInterrupt):
                view.wait()


def announce(line: str) -> None:
    """Print a status line, such as that the first run compiles, to stderr."""
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
    if run.folder is not None:
        files = [run.folder / name for name in ("map.png", "map.yaml") if (run.folder / name).exists()]
        lines |= {"files": ", ".join(map(str, files))} if files else {}
        lines["report"] = f"sixthsense report {shlex.quote(str(run.folder))} writes figures/report.html"
    print(*(f"{label:12} {text}" for label, text in lines.items()), f"written to {run.folder}/", sep="\n")
    code = EXIT_CODES.get(run.outcome, FAILED)
    if options.strict and code == DONE and run.verdict is not None:
        return EXIT_CODES_OF_MAPS[run.verdict.level]
    return code


def _behind(place: UnseenPlace) -> str:
    return "" if place.gap_m is None else f" behind a gap of {place.gap_m:.2f} m"


def _described(place: UnseenPlace) -> str:
    return f"({place.x:.2f}, {place.y:.2f}) {place.area_m2:.2g} m², {place.reason}{_behind(place)}"
