"""`sixthsense completion`: the completion script of a shell, which shtab writes from the options of every command."""

from __future__ import annotations

import argparse
import dataclasses
import inspect
from collections.abc import Iterator
from importlib import import_module

from sixthsense.cli import COMMANDS
from sixthsense.cli.common import Common, wants_help
from sixthsense.cli.exits import DONE
from sixthsense.cli.help import Option, config_options, option_of, own_options
from sixthsense.cli.options import UsageError
from sixthsense.config import PRESETS, Config
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.sources.scene_files import shipped_scenes

SHELLS = ("bash", "zsh", "fish")

USAGE = """\
usage: sixthsense completion bash|zsh|fish

Print a script that lets the shell complete commands, options and names.

  bash  sixthsense completion bash >> ~/.bash_completion
  zsh   sixthsense completion zsh > FOLDER/_sixthsense, in a FOLDER of $fpath
  fish  sixthsense completion fish > ~/.config/fish/completions/sixthsense.fish
"""


def command(args: list[str]) -> int:
    """Print the completion script of a shell."""
    if wants_help(args):
        print(USAGE, end="")
        return DONE
    if len(args) != 1 or args[0] not in SHELLS:
        found = repr(" ".join(args)) if args else "nothing"
        raise UsageError(f"shell: found {found}, {allowed_names(SHELLS, nearest(' '.join(args), SHELLS))}")
    import shtab

    print(shtab.complete(parser(), args[0]))
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
    """The options of a command: of its dataclass, or of the table OWN of its module; the configuration's if it has."""
    module = import_module(f"sixthsense.cli.{name}")
    classes = [one for _, one in inspect.getmembers(module, inspect.isclass) if one.__module__ == module.__name__]
    own = next((one for one in classes if issubclass(one, Common)), None)
    if own is not None:
        of_command = list(own_options(own))
        yield from of_command
        taken = {option.name for option in of_command}
        yield from (option for option in config_options(Config()) if option.name not in taken)
    else:
        for key, hint in getattr(module, "OWN", {}).items():
            yield option_of(key, hint)
    if name == "campaign":
        yield option_of("seeds", str)
        yield from config_options(Config())
    if name == "completion":
        yield dataclasses.replace(option_of("shell", str), is_positional=True, choices=SHELLS)


def _add(command_parser: argparse.ArgumentParser, option: Option) -> None:
    import shtab

    choices = option.choices
    if option.name == "preset":
        choices = tuple(PRESETS)
    if option.name == "scene":
        choices = tuple(shipped_scenes())
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
