"""`sixthsense scenes`, `parts` and `completion`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from sixthsense.cli import COMMANDS, DONE, command_class
from sixthsense.cli.help import Help, brief
from sixthsense.cli.options import Arg, Option, Options, Parser, Table, add_options, flag_name
from sixthsense.config import PRESETS
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import KINDS
from sixthsense.simulation.scene_files import shipped_scenes

SHELLS = ("bash", "zsh", "fish")


class Scenes(Options):
    """List the shipped scenes, or draw one before a run: walls, glass, region, start, goals and people."""

    scene: Annotated[str | None, Arg("[SCENE]", is_positional=True)] = None
    """Shipped scene, or file .toml, .yaml (ROS map), .scn."""
    out: Annotated[Path | None, Arg("FILE")] = None
    """The picture, .png, .svg or .pdf; by default runs/scenes/NAME.png."""

    def run(self, flags: Table) -> int:
        """List the shipped scenes, or draw one."""
        from sixthsense.simulation.mission import unreachable
        from sixthsense.simulation.scene import load_scene

        if self.scene is None:
            print(*(load_scene(name).summary() for name in shipped_scenes()), sep="\n")
            return DONE
        from sixthsense.figures.plot import save

        scene = load_scene(self.scene)
        file = self.out or Path("runs/scenes") / f"{scene.name}.png"
        save(scene.plot(), file)
        notes = [*scene.notes, *filter(None, [unreachable(scene)])]
        print(scene.summary(), *notes, f"written to {file}", sep="\n")
        return DONE


class Parts(Options):
    """List the parts that can be replaced: the shipped ones, and those that installed packages register.

    One of your own is named by its import path, `--estimator lab.fading:Fading`, wherever a name is taken. A part is
    code: the working folder is searched for one that the command line names, and `--parts DIR` for one that a file
    names. Its options are the fields of its class `Options`: `--estimator-options.gain 0.9`. A
    package gives it a short name in the entry points of the group.
    """

    def run(self, flags: Table) -> int:
        """List the parts."""
        for parts in KINDS:
            print(f"--{flag_name(parts.kind)} (contract: {parts.seam}; group of entry points: {parts.group})")
            for name, path in {**parts.shipped, **parts.installed()}.items():
                print(f"  {name:16}  {path}{'' if name in parts.shipped else ', installed'}")
        return DONE


class Completion(Options):
    """Print a script that lets the shell complete commands, options and names."""

    shell: Annotated[str, Arg("SHELL", is_positional=True)] = ""
    """bash, zsh or fish. Append the script to ~/.bash_completion, or write it to FOLDER/_sixthsense with a FOLDER of
    $fpath, or to ~/.config/fish/completions/sixthsense.fish."""

    def run(self, flags: Table) -> int:
        """Print the completion script of a shell."""
        if self.shell not in SHELLS:
            found = repr(self.shell) if self.shell else "nothing"
            raise InputError("shell", f"found {found}", ", ".join(SHELLS), nearest(self.shell, SHELLS))
        import shtab

        root = Parser(prog="sixthsense")
        root.add_argument("--help", action="help", help="list the commands")
        root.add_argument("--version", action="version", version="", help="tell the version")
        commands = root.add_subparsers()
        for name, (_, _, purpose) in COMMANDS.items():
            command = commands.add_parser(name, help=purpose)
            add_options(command, command_class(name))
            for option in command._actions:
                _complete(option)
        print(shtab.complete(root, self.shell))
        return DONE


def parser_of(name: str, command: type[Options]) -> Parser:
    """The parser of a command: its options, those of the configuration if it takes them, and the help."""
    parser = Parser(prog=f"sixthsense {name}", usage="")
    add_options(parser, command)
    action = parser.add_argument("-h", "--help", action=Help, nargs="?", default=argparse.SUPPRESS)
    action.command = command  # type: ignore[attr-defined]
    return parser


def _complete(option: argparse.Action) -> None:
    """What shtab needs: a text of one sentence, names to complete, and which values are files."""
    import shtab

    if not isinstance(option, Option):
        return
    known: dict[str, Iterable[str]] = {"preset": PRESETS, "scene": shipped_scenes(), "shell": SHELLS}
    option.help = brief(option.field.description).replace("%", "%%")
    if names := known.get(option.dest):
        option.choices = tuple(names)
    elif option.kind is Path or "DIR" in option.arg.metavar or not option.option_strings:
        option.complete = shtab.FILE  # type: ignore[attr-defined]
