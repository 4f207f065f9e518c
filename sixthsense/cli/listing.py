"""`sixthsense scenes` and `parts`; the parsers of all commands."""

import argparse
from pathlib import Path
from typing import Annotated

from sixthsense.cli import COMMANDS, DONE, command_class
from sixthsense.cli.help import Help, brief
from sixthsense.cli.options import Arg, Options, Parser, Table, flag_name
from sixthsense.config import PRESETS
from sixthsense.config.parts import KINDS
from sixthsense.config.section import choices_of


class Scenes(Options):
    """List the shipped scenes, or what is to be said of one before a run. In Python its method plot() draws it."""

    scene: Annotated[str | None, Arg("[SCENE]", is_positional=True)] = None
    """Shipped scene, or file .toml or .yaml (ROS map)."""

    def run(self, flags: Table) -> int:
        """List the shipped scenes, or describe one."""
        from sixthsense.simulation.mission import unreachable
        from sixthsense.simulation.scene import load_scene
        from sixthsense.simulation.scene_files import shipped_scenes

        for scene in map(load_scene, shipped_scenes() if self.scene is None else (self.scene,)):
            print(scene.summary(), *scene.notes, *filter(None, [unreachable(scene)]), sep="\n")
        return DONE


class Parts(Options):
    """List the parts that can be replaced, and the shipped ones.

    One of your own is named by its import path, `--estimator lab.fading:Fading`, wherever a name is taken. A part is
    code: the working folder is searched for one that the command line names, and `--parts DIR` for one that a file
    names. Its options are the fields of its class `Options`: `--estimator-options.gain 0.9`.
    """

    def run(self, flags: Table) -> int:
        """List the parts."""
        for parts in KINDS:
            print(f"--{flag_name(parts.kind)} (contract: {parts.seam})")
            for name, path in parts.shipped.items():
                print(f"  {name:16}  {path}")
        return DONE


def parser_of(name: str, command: type[Options]) -> Parser:
    """The parser of a command: its options, those of the configuration if it takes them, and the help."""
    parser = Parser(prog=f"sixthsense {name}", usage="")
    parser.add_options(command)
    action = parser.add_argument("-h", "--help", action=Help, nargs="?", default=argparse.SUPPRESS)
    action.command = command  # type: ignore[attr-defined]
    return parser


def whole_parser() -> Parser:
    """The parser of all commands, from which `shtab --shell SHELL sixthsense.cli.listing.whole_parser` completes."""
    import shtab

    from sixthsense.simulation.scene_files import shipped_scenes

    root = Parser(prog="sixthsense")
    commands = root.add_subparsers()
    for name, (_, _, purpose) in COMMANDS.items():
        command = commands.add_parser(name, help=purpose)
        command.add_options(command_class(name))
        for option in command.options:
            option.help = brief(option.field.description).replace("%", "%%")
            option.choices = choices_of(option.field) or None
            if option.dest in ("preset", "scene"):
                option.choices = tuple(PRESETS if option.dest == "preset" else shipped_scenes())
            elif option.kind is Path or "DIR" in option.arg.metavar or not option.option_strings:
                option.complete = shtab.FILE  # type: ignore[attr-defined]
    return root
