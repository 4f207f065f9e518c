"""`sixthsense scenes`."""

from __future__ import annotations

from sixthsense.cli.common import wants_help
from sixthsense.cli.exits import DONE
from sixthsense.cli.options import UsageError


def command(args: list[str]) -> int:
    """List the shipped scenes."""
    if wants_help(args):
        print("usage: sixthsense scenes\n\nList the shipped scenes.")
        return DONE
    if args:
        raise UsageError(f"scenes: found {args[0]!r}, allowed: no arguments")
    from sixthsense.sources.scene import load_scene, shipped_scenes

    for name in shipped_scenes():
        scene = load_scene(name)
        x0, y0, x1, y1 = scene.region
        size = f"{x1 - x0:.0f} x {y1 - y0:.0f} m"
        print(f"{name:10}  {size:>10}  {len(scene.walls):6,d} walls  {len(scene.tour):2d} goals on the tour")
    return DONE
