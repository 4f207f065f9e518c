"""`sixthsense scenes`, `parts` and `completion`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sixthsense.cli import COMMANDS, DONE, command_class
from sixthsense.cli.help import brief
from sixthsense.cli.options import Option, Options, arg, flag_of, options_of, parse, positional
from sixthsense.config import PRESETS
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import KINDS
from sixthsense.simulation.scene_files import shipped_scenes

SHELLS = ("bash", "zsh", "fish")


@dataclass(frozen=True)
class Scenes(Options):
    """List the shipped scenes, or draw one before a run: walls, glass, region, start, goals and people."""

    scene: Annotated[str | None, positional("[SCENE]")] = None
    """Shipped scene, or file .toml, .yaml (ROS map), .scn."""
    out: Annotated[Path | None, arg("FILE")] = None
    """The picture, .png, .svg or .pdf; by default runs/scenes/NAME.png."""

    @classmethod
    def main(cls, args: list[str]) -> int:
        """List the shipped scenes, or draw one."""
        given, _ = parse(args, Scenes)
        options = Scenes(**given)
        from sixthsense.simulation.scene import load_scene

        if options.scene is None:
            print(*(load_scene(name).summary() for name in shipped_scenes()), sep="\n")
            return DONE
        from sixthsense.figures.plot import save

        scene = load_scene(options.scene)
        file = options.out or Path("runs/scenes") / f"{scene.name}.png"
        save(scene.plot(), file)
        print(scene.summary(), *scene.notes, f"written to {file}", sep="\n")
        return DONE


@dataclass(frozen=True)
class Parts(Options):
    """List the parts that can be replaced: the shipped ones, and those that installed packages register.

    One of your own is named by its import path, `--estimator lab.fading:Fading`, wherever a name is taken; the current
    folder is searched, too. Its options are the fields of its class `Options`: `--estimator-options.gain 0.9`. A
    package gives it a short name in the entry points of the group.
    """

    @classmethod
    def main(cls, args: list[str]) -> int:
        """List the parts."""
        parse(args, Parts)
        for parts in KINDS:
            print(f"{flag_of(parts.kind)} (contract: {parts.seam}; group of entry points: {parts.group})")
            for name, path in {**parts.shipped, **parts.installed()}.items():
                print(f"  {name:16}  {path}{'' if name in parts.shipped else ', installed'}")
        return DONE


@dataclass(frozen=True)
class Completion(Options):
    """Print a script that lets the shell complete commands, options and names."""

    shell: Annotated[str, positional("SHELL")] = ""
    """bash, zsh or fish. Append the script to ~/.bash_completion, or write it to FOLDER/_sixthsense with a FOLDER of
    $fpath, or to ~/.config/fish/completions/sixthsense.fish."""

    @classmethod
    def main(cls, args: list[str]) -> int:
        """Print the completion script of a shell."""
        shell = Completion(**parse(args, Completion)[0]).shell
        if shell not in SHELLS:
            found = repr(shell) if shell else "nothing"
            raise InputError("shell", f"found {found}", ", ".join(SHELLS), nearest(shell, SHELLS))
        import shtab

        print(shtab.complete(parser(), shell))
        return DONE


def parser() -> argparse.ArgumentParser:
    """A parser that knows the commands and options by name, for shtab alone: `options.parse` reads command lines."""
    root = argparse.ArgumentParser(prog="sixthsense", add_help=False)
    root.add_argument("--help", action="help", help="list the commands")
    root.add_argument("--version", action="version", version="", help="tell the version")
    commands = root.add_subparsers()
    for name, (_, _, purpose) in COMMANDS.items():
        one = commands.add_parser(name, help=_escaped(purpose), add_help=False)
        one.add_argument("--help", action="help", help="list the options")
        for option in options_of(command_class(name)):
            _add(one, option)
    return root


def _add(command_parser: argparse.ArgumentParser, option: Option) -> None:
    import shtab

    known = {"preset": tuple(PRESETS), "scene": tuple(shipped_scenes()), "shell": SHELLS}
    choices = known.get(option.name, option.choices) or None
    text, name = _escaped(brief(option)), option.flag.replace("_", "-")
    if option.is_positional:
        action = command_parser.add_argument(name, help=text, nargs="?", choices=choices)
    elif not option.metavar:
        action = command_parser.add_argument(name, help=text, action="store_true")
    else:
        action = command_parser.add_argument(name, help=text, choices=choices)
    if option.kind is Path or option.metavar in ("FILE", "DIR") or (option.is_positional and not choices):
        action.complete = shtab.FILE  # type: ignore[attr-defined]


def _escaped(text: str) -> str:
    return text.replace("%", "%%")
