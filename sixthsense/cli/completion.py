"""`sixthsense completion`: the completion script of a shell, which shtab writes from the options of every command."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

from sixthsense.cli import COMMANDS, DONE
from sixthsense.cli.help import Option, command_class, config_options, own_options
from sixthsense.cli.options import Options, parse, positional
from sixthsense.config import PRESETS, Config
from sixthsense.config.errors import InputError, nearest
from sixthsense.sources.scene_files import shipped_scenes

SHELLS = ("bash", "zsh", "fish")


@dataclass(frozen=True)
class Completion(Options):
    """Print a script that lets the shell complete commands, options and names."""

    shell: Annotated[str, positional("SHELL")] = ""
    """bash, zsh or fish. Append the script to ~/.bash_completion, or write it to FOLDER/_sixthsense with a FOLDER of
    $fpath, or to ~/.config/fish/completions/sixthsense.fish."""


def command(args: list[str]) -> int:
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
    for name, (_, purpose) in COMMANDS.items():
        one = commands.add_parser(name, help=_escaped(purpose), add_help=False)
        one.add_argument("--help", action="help", help="list the options")
        for option in options_of(name):
            _add(one, option)
    return root


def options_of(name: str) -> Iterator[Option]:
    """The options of a command, and those of the configuration if it takes them."""
    command_options = list(own_options(command_class(name)))
    yield from command_options
    if command_class(name).takes_fields:
        taken = {option.name for option in command_options}
        yield from (option for option in config_options(Config()) if option.name not in taken)


def _add(command_parser: argparse.ArgumentParser, option: Option) -> None:
    import shtab

    known: dict[str, Iterable[str]] = {"preset": PRESETS, "scene": shipped_scenes(), "shell": SHELLS}
    choices = tuple(known.get(option.name, option.choices))
    text = _escaped(option.brief)
    if option.is_positional:
        action = command_parser.add_argument(option.name, help=text, nargs="?", choices=choices or None)
    elif not option.takes_value:
        action = command_parser.add_argument(f"--{option.name}", help=text, action="store_true")
    else:
        action = command_parser.add_argument(f"--{option.name}", help=text, choices=choices or None)
    if option.is_path or (option.is_positional and not choices):
        action.complete = shtab.FILE  # type: ignore[attr-defined]


def _escaped(text: str) -> str:
    return text.replace("%", "%%")
