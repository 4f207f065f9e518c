import io
from contextlib import redirect_stderr, redirect_stdout

import pytest
import shtab

from sixthsense import cli
from sixthsense.cli.listing import whole_parser

WITH_SETTINGS = ["run", "replay", "calibrate"]


def said(*args: str) -> tuple[int, str, str]:
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = cli.main(list(args))
    return code, out.getvalue(), err.getvalue()


def page(*args: str) -> list[str]:
    code, out, err = said(*args)
    assert (code, err) == (cli.DONE, "")
    return out.splitlines()


@pytest.mark.parametrize("command", WITH_SETTINGS)
def test_the_whole_help_has_every_option_once_within_80_columns(command: str) -> None:
    lines = page(command, "--help", "all")
    assert lines == page(command, "--help=all")
    assert max(map(len, lines)) <= 80
    flags = [line.split()[0] for line in lines if line.startswith("  --")]
    assert len(flags) > 70 and len(flags) == len(set(flags))


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_prints_a_script_with_commands_options_and_names(shell: str) -> None:
    script = shtab.complete(whole_parser(), shell)
    words = ["sixthsense", "replay", "laser.beams", "isam2", "apartment", "seeds"]
    assert all(word in script for word in words)
