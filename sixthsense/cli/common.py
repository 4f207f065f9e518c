"""What the commands share: options, help, the run's folder, the progress bar and the table at the end."""

from __future__ import annotations

import contextlib
import sys
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

from sixthsense.cli.exits import DONE, EXIT_CODES, FAILED
from sixthsense.cli.options import OrAlone, Table, parse
from sixthsense.config import Config, load_config, merge, preset
from sixthsense.view.viewer import PLACES, is_place

if TYPE_CHECKING:
    from sixthsense.figures.run import Run
    from sixthsense.navigation.unseen_places import UnseenPlace
    from sixthsense.record.folder import RunFolder

C = TypeVar("C", bound="Common")


@dataclass(frozen=True)
class Common:
    """Options that every command with a run folder has."""

    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """TOML file, partial or whole, over the preset; a run folder's config.toml repeats that run."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder to write; by default a new one under runs/."""
    overwrite: bool = False
    """Replace the folder if it exists."""
    view: Annotated[str | None, tyro.conf.arg(metavar="[window|browser|FILE.rrd]")] = None
    """Show it as it goes, in Rerun (pip install 'sixthsense[view]'): in a window, in a browser, or write a file."""
    bind: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """With --view browser: where its server listens, 127.0.0.1 unless told otherwise; whoever reaches it looks on."""
    settings: Annotated[Config, tyro.conf.arg(name="")] = field(default_factory=Config)


def show_help(command: type[Common], name: str, base: str) -> int:
    """Print a command's options, with the values they have by default."""
    with contextlib.suppress(SystemExit):
        tyro.cli(command, prog=f"sixthsense {name}", args=["--help"], default=command(settings=preset(base)))
    return DONE


def parse_command(
    command: type[C], place: str, base: str | Callable[[str | None], str | Config], args: list[str]
) -> tuple[C, Table]:
    """A command's options, and the table of those fields of Config that flags set.

    `place` names the option that stands by itself, `base` is the preset where none is named, or the whole
    configuration; it may depend on what stands at `place`. Precedence is defaults <
    preset < configuration file < flags; a ConfigError names the flag, or the file and its field.
    """
    own = {name: hint for name, hint in typing.get_type_hints(command).items() if name not in ("settings", place)}
    own["view"] = OrAlone("window", is_place, PLACES)
    given, table = parse(args, own, place)
    start = base(given.get(place)) if callable(base) else base
    settings = start if isinstance(start, Config) and "preset" not in table else preset(table.get("preset", start))
    if "config" in given:
        whole = "preset" in table or isinstance(start, Config)
        settings = load_config(given["config"], settings if whole else None, str(start))
    # A file has the last word on which preset its values are of.
    flags = {name: value for name, value in table.items() if name != "preset"}
    return command(**given, settings=merge(settings, flags, "--")), table


def wants_help(args: list[str]) -> bool:
    """Whether the words ask for help, wherever they do."""
    return "-h" in args or "--help" in args


def run_folder(options: Common, config: Config, stem: str, replayed: Mapping[str, str] | None = None) -> RunFolder:
    """The folder that the options name, or a new one under runs/ that begins with `stem`."""
    from sixthsense.record.folder import RunFolder

    if options.out is not None:
        return RunFolder(options.out, config, options.overwrite, replayed)
    return RunFolder(numbered(stem), config, replayed=replayed)


def numbered(stem: str) -> Path:
    """The first folder under runs/ that is not taken."""
    number = 1
    while (out := Path("runs") / f"{stem}-{number}").exists() or out.with_name(out.name + ".partial").exists():
        number += 1
    return out


def announce(line: str) -> None:
    """Say why a first run does not start at once."""
    print(line, file=sys.stderr)


def show_end(run: Run) -> int:
    """Print the table of a run's metrics, what it has left unseen, and its folder; returns the exit code."""
    from sixthsense.evaluation.tables import digits, text_table

    print(text_table([[key, digits(value)] for key, value in run.metrics.items()]))
    if run.trace.left:
        print(f"left unseen: {'; '.join(map(_described, run.trace.left))}")
    print(f"written to {run.folder}/")
    return EXIT_CODES.get(run.outcome, FAILED)


def _described(place: UnseenPlace) -> str:
    return f"({place.x:.2f}, {place.y:.2f}) {place.area_m2:.2g} m^2, {place.reason}"
