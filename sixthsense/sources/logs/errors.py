"""What is wrong with a log, or with its file."""

from __future__ import annotations

from pathlib import Path

from sixthsense.config.errors import InputError


class LogError(InputError):
    """One line that names the file and line, what was found and what is allowed."""


def check_regular(path: Path) -> None:
    """Raise LogError if a path, or a file in that folder, is a pipe or a device, which may never end."""
    for file in (path, *path.iterdir()) if path.is_dir() else (path,):
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise LogError(f"{file}: is a pipe or a device, allowed: a file")
