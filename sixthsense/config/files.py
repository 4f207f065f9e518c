"""Presets, named sets of values over the defaults in `presets.toml`, and configurations in TOML files."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import import_named
from sixthsense.config.section import as_table, merge, shown
from sixthsense.config.sections import Config
from sixthsense.config.version import __version__

if TYPE_CHECKING:
    from sixthsense.config.fields import Fields

_MOST_BYTES = 1 << 23
"""of a configuration or a scene: a larger file is none, and reading it may take long"""
# The parser's time grows with the square of a dotted key's length: 24 kB of `a.a.a...` take seconds.
_DEEP_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){20}""")
NOTES = ("versions", "replayed", "prior_map")
"""tables of a saved configuration that inform a reader and are no settings"""
Note = Mapping[str, Any] | None


PRESETS: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("presets.toml").read_text("utf-8"))


def preset(name: str = "default", **changes: Unpack[Fields]) -> Config:
    """The named preset's Config, with the fields in `changes` (nested tables for sections) replaced.

    Raises InputError that lists the known names for any other, or names the field with a wrong value.
    """
    if name not in tuple(PRESETS):  # a file may hold a list there, which is not hashable
        raise InputError("preset", f"found {shown(name)}", ", ".join(PRESETS), nearest(name, PRESETS))
    import_named(changes)
    return merge(merge(Config().model_copy(update={"preset": name}), PRESETS[name]).as_implied(), changes)


def path_of(name: str, value: object) -> Path:
    """The argument `name` as a path; InputError for what is none."""
    if not isinstance(value, str | os.PathLike):
        raise InputError(name, f"found {shown(value)}", "a path")
    return Path(value)


def instead_of(folder: Path, name: str) -> str:
    """What is found where a folder should hold the file of that name."""
    return f"no {name} in it" if folder.is_dir() else "a file" if folder.exists() else "no such folder"


def load_config(file: str | Path, base: Config | None = None) -> Config:
    """Read a TOML file, partial or whole, over `base`; without one over the preset it names, by default `default`.

    The fields of a file count as stated, but for the saved configuration of a simulated run, which has them all. Raises
    InputError for a file that cannot be read, is not TOML, or holds a field or value that is not allowed.
    """
    path = Path(file)
    table = read_table(path)
    notes = [table.pop(note, None) for note in NOTES]
    try:
        config = merge(base or preset(table.get("preset", "default")), table)
    except InputError as error:
        raise error.within(path) from None
    has_all, is_replayed = (note is not None for note in notes[:2])
    return config.as_implied() if has_all and not is_replayed else config


def read_table(file: str | Path) -> dict[str, Any]:
    """The nested table of a TOML file; InputError for a file that cannot be read, or is not TOML."""
    path = Path(file)
    try:
        if path.exists() and not (path.is_dir() or (path.is_file() and path.stat().st_size <= _MOST_BYTES)):
            raise InputError(path, f"is a pipe, a device, or has over {_MOST_BYTES:,} bytes", "a TOML file")
        with path.open(encoding="utf-8-sig") as stream:
            return parse_toml(stream.read())
    except InputError:
        raise
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise InputError(path, str(error)) from None


def save_config(config: Config, file: str | Path, replayed: Note = None, prior_map: Note = None) -> None:
    """Write the whole tree as TOML, with the versions that ran it and, for a replay, the files that were `replayed`.

    `prior_map` says which one the run began with. `load_config` reads the same Config.
    """
    import platform
    from importlib.metadata import version

    import tomli_w

    versions = {"sixthsense": __version__, "python": platform.python_version()}
    versions |= {name: version(name) for name in ("numpy", "scipy", "numba")}
    tables = zip(NOTES, (versions, replayed, prior_map), strict=True)
    notes = {name: dict(note) for name, note in tables if note is not None}
    Path(file).write_text(tomli_w.dumps({**as_table(config), **notes}), encoding="utf-8")


def absolute(path: str | Path) -> Path:
    """The absolute path, links followed; links that form a loop are left to whoever opens it."""
    return Path(os.path.realpath(path))


def notes_of(file: str | Path) -> dict[str, Any]:
    """The tables of `NOTES` in a valid configuration file: `replayed` if a replay has saved it, `prior_map` if any."""
    return {name: note for name, note in read_table(file).items() if name in NOTES}


def parse_toml(text: str) -> dict[str, Any]:
    """The table of a TOML text; ValueError says in a few words why it is invalid."""
    if _DEEP_KEY.search(text):
        raise ValueError("is not usable TOML (found a key of over 20 parts)")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"is not TOML ({str(error).split(';')[0]})") from None
