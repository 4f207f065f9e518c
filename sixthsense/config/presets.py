"""Presets: named sets of values over the defaults, in `presets.toml`."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import import_named
from sixthsense.config.section import merge, shown
from sixthsense.config.sections import Config

if TYPE_CHECKING:
    from sixthsense.config.fields import Fields

PRESETS: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("presets.toml").read_text("utf-8"))


def preset(name: str = "default", **changes: Unpack[Fields]) -> Config:
    """The named preset's Config, with the fields in `changes` (nested tables for sections) replaced.

    Raises InputError that lists the known names for any other, or names the field with a wrong value.
    """
    if name not in tuple(PRESETS):  # a file may hold a list there, which is not hashable
        raise InputError("preset", f"found {shown(name)}", ", ".join(PRESETS), nearest(name, PRESETS))
    import_named(changes)
    return merge(merge(Config(preset=name), PRESETS[name]).as_implied(), changes)
