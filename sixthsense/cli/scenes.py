"""`sixthsense scenes`."""

from __future__ import annotations

from dataclasses import dataclass

from sixthsense.cli import DONE
from sixthsense.cli.options import Options, parse


@dataclass(frozen=True)
class Scenes(Options):
    """List the shipped scenes."""


def command(args: list[str]) -> int:
    """List the shipped scenes."""
    parse(args, Scenes)
    from sixthsense.sources.scene import load_scene, shipped_scenes

    for name in shipped_scenes():
        scene = load_scene(name)
        x0, y0, x1, y1 = scene.region
        size = f"{x1 - x0:.0f} x {y1 - y0:.0f} m"
        print(f"{name:10}  {size:>10}  {len(scene.walls):6,d} walls  {len(scene.tour):2d} goals on the tour")
    return DONE
