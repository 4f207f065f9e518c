"""`sixthsense scenes`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli import DONE
from sixthsense.cli.options import Options, arg, parse, positional


@dataclass(frozen=True)
class Scenes(Options):
    """List the shipped scenes, or draw one before a run: walls, glass, region, start, goals and people."""

    scene: Annotated[str | None, positional("[SCENE]")] = None
    """Shipped scene, or file .toml, .yaml (ROS map), .scn."""
    out: Annotated[Path | None, arg("FILE")] = None
    """The picture, .png, .svg or .pdf; by default runs/scenes/NAME.png."""


def command(args: list[str]) -> int:
    """List the shipped scenes, or draw one."""
    given, _ = parse(args, Scenes)
    options = Scenes(**given)
    from sixthsense.sources.scene import load_scene, shipped_scenes

    if options.scene is None:
        for name in shipped_scenes():
            print(load_scene(name).summary())
        return DONE
    from sixthsense.figures.plot import save

    scene = load_scene(options.scene)
    file = options.out or Path("runs/scenes") / f"{scene.name}.png"
    save(scene.plot(), file)
    print(scene.summary(), *scene.notes, f"written to {file}", sep="\n")
    return DONE
