"""Configurations in TOML files."""

from __future__ import annotations

import tomllib
from pathlib import Path

from sixthsense import __version__
from sixthsense.config.presets import preset
from sixthsense.config.section import ConfigError, as_table, merge
from sixthsense.config.tree import Config


def load_config(file: str | Path, base: Config | None = None, otherwise: str = "default") -> Config:
    """Read a TOML file, partial or whole, over `base`; without one over the preset it names, `otherwise` if none.

    Raises ConfigError for a file that cannot be read, is not TOML, or holds a field that is not allowed.
    """
    path = Path(file)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not UTF-8 text, allowed: a TOML file") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: is not TOML ({error})") from None
    except ValueError as error:  # Python's limit on the digits of an integer
        raise ConfigError(f"{path}: is not usable TOML ({str(error).split(';')[0]})") from None
    table.pop("versions", None)  # written for the reader of a run folder, not a setting
    try:
        return merge(base or preset(table.get("preset", otherwise)), table)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def save_config(config: Config, file: str | Path) -> None:
    """Write the whole tree, and the versions that ran it, as TOML; `load_config` reads the same Config back."""
    import platform
    from importlib.metadata import version

    import tomli_w

    versions = {"sixthsense": __version__, "python": platform.python_version()}
    versions |= {name: version(name) for name in ("numpy", "scipy", "numba")}
    Path(file).write_text(tomli_w.dumps({**as_table(config), "versions": versions}), encoding="utf-8")
