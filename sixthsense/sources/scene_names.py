"""The names of scenes: those that are shipped, and files. Loads nothing, so that a wrong name is told at once."""

from __future__ import annotations

from pathlib import Path

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.config.suggestion import allowed_names, nearest

SUFFIXES = (".toml", ".yaml", ".yml", ".scn")


class SceneError(InputError):
    """One line that names the file, the field or line, what was found and what is allowed."""


def shipped_scenes() -> dict[str, Path]:
    """The files of the shipped scenes by name, in alphabetical order."""
    package = Path(__file__).resolve().parents[1]
    # A wheel contains the scenes inside the package; an editable install has them in the root of the repository.
    folder = next((f for f in (package / "scenes", package.parent / "scenes") if f.is_dir()), None)
    return {} if folder is None else {file.stem: file for file in sorted(folder.glob("*.toml"))}


def scene_file(name_or_file: str | Path) -> Path:
    """The file of a shipped scene, or the file itself; SceneError for a name that is neither, with the known ones."""
    shipped = shipped_scenes()
    path = shipped.get(str(name_or_file), Path(name_or_file))
    if path.suffix.lower() not in SUFFIXES:
        found = str(name_or_file)
        allowed = allowed_names(shipped, nearest(found, shipped), f", or a file ending in {', '.join(SUFFIXES)}")
        raise SceneError(f"scene: found {shown(found)}, {allowed}")
    return path
