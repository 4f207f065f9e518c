import io
import os
import pty
import re
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from sixthsense import cli
from sixthsense.cli.help import help_topic, own_options
from sixthsense.cli.run import Run
from sixthsense.config import Config
from sixthsense.config.suggestion import nearest

WITH_SETTINGS = ["run", "replay", "calibrate"]
ESCAPE = "\x1b"


def said(*args: str) -> tuple[int, str, str]:
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = cli.main(list(args))
    return code, out.getvalue(), err.getvalue()


def page(*args: str) -> list[str]:
    code, out, err = said(*args)
    assert (code, err) == (cli.DONE, "")
    return out.splitlines()


def test_the_help_fits_on_a_screen_of_24_lines_and_80_columns() -> None:
    lines = page("--help")
    assert len(lines) <= 24 and max(map(len, lines)) <= 80
    assert all(any(line.startswith(f"  {name} ") for line in lines) for name in cli.COMMANDS)


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_the_help_of_a_command_has_at_most_60_lines_of_80_columns(command: str) -> None:
    lines = page(command, "--help")
    assert len(lines) <= 60
    assert max(map(len, lines)) <= (120 if command in ("campaign", "report") else 80)


@pytest.mark.parametrize("command", WITH_SETTINGS)
def test_the_short_help_names_every_section_and_how_to_list_it(command: str) -> None:
    lines = page(command, "--help")
    assert any(line.startswith("  laser  ") for line in lines)
    assert "`--help SECTION`" in lines[-1] and "`--help all`" in lines[-1]


@pytest.mark.parametrize("command", WITH_SETTINGS)
def test_the_whole_help_has_every_option_once_within_80_columns(command: str) -> None:
    lines = page(command, "--help", "all")
    assert lines == page(command, "--help-all") == page(command, "--help=all")
    assert max(map(len, lines)) <= 80
    flags = [line.split()[0] for line in lines if line.startswith("  --")]
    assert len(flags) > 70 and len(flags) == len(set(flags))


def test_the_help_of_a_section_has_its_settings_and_those_of_its_parts_with_default_and_allowed_values() -> None:
    lines = page("run", "--help", "laser")
    assert lines[:2] == ["laser:", "  The scanner, its mount and its rate."]
    flags = {line.split()[0] for line in lines if line.startswith("  --")}
    assert {"--laser.beams", "--laser.fov"} <= flags and all(flag.startswith("--laser.") for flag in flags)
    assert "(default 360; allowed: 2 to 100000)" in " ".join(" ".join(lines).split())
    assert any(line.startswith("  --features.split.epsilon-m") for line in page("run", "--help", "features"))
    assert page("run", "--help", "features.split")[0] == "features.split:"


def test_the_help_of_a_single_option_is_its_text() -> None:
    text = " ".join(page("run", "--help", "estimator"))
    assert "--estimator NAME" in text and "allowed: ekf, ekf-fej" in text
    assert page("run", "--help", "beams") == page("run", "--help", "laser.beams")


def test_an_unknown_topic_of_the_help_is_told_with_the_nearest_one() -> None:
    code, out, err = said("run", "--help", "lasr")
    assert (code, out) == (cli.BAD_INPUT, "")
    assert err.startswith("sixthsense: --help: found 'lasr', did you mean laser? allowed: robot, laser,")


def test_the_help_of_replay_leaves_out_what_a_replay_refuses() -> None:
    lines = "\n".join(page("replay", "--help", "all"))
    assert "--goal" not in lines and "--tour" not in lines and "--world." not in lines
    assert "--laser.beams" in lines and "(default isam2;" in lines


def test_help_is_asked_for_in_these_ways() -> None:
    assert help_topic(["office", "--seed", "3"]) is None
    assert help_topic(["office", "-h"]) == help_topic(["--help", "--seed", "3"]) == ""
    assert help_topic(["--help", "laser"]) == help_topic(["--help=laser"]) == "laser"


def test_every_option_has_a_text() -> None:
    assert all(option.text.endswith(".") for option in own_options(Run))


@pytest.mark.parametrize(
    ("line", "suggested"),
    [
        ("rnu apartment", "run"),
        ("run apartmnt", "apartment"),
        ("calibrate ofice --out n.toml", "office"),
        ("run --planer astar", "--planner"),
        ("run --laser.beems 3", "--laser.beams"),
        ("run --beams 3", "--laser.beams"),
        ("run --estimator ekf-invarient", "ekf-invariant"),
        ("run --estimator ISAM2", "isam2"),
        ("run --planner rrt", "rrtstar"),
        ("run --preset wron", "worn"),
        ("run --task explor", "explore"),
        ("report somewhere --figure svg", "--figures"),
        ("completion zhs", "zsh"),
    ],
)
def test_a_misspelt_name_is_answered_with_the_nearest_known_one_before_the_list(line: str, suggested: str) -> None:
    code, out, err = said(*line.split())
    assert (code, out) == (cli.BAD_INPUT, "")
    assert err.count("\n") == 1 and f", did you mean {suggested}? allowed: " in err


def test_a_name_like_no_other_gets_no_suggestion() -> None:
    assert nearest("quux", ["run", "replay"]) == nearest("x" * 1000, ["x" * 999]) == nearest(3, "3") == ""
    assert "did you mean" not in said("run", "--bogus")[2] + said("run", "--features.lines.x", "3")[2]
    assert "did you mean" not in said("run", "--laser", "3")[2]  # a section, whose options the message lists


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_a_script_with_commands_options_and_names(shell: str) -> None:
    pytest.importorskip("shtab")
    script = "\n".join(page("completion", shell))
    words = ["sixthsense", "replay", "laser.beams", "isam2", "apartment", "seeds"]
    assert all(word in script for word in words)


def test_bash_completes_commands_scenes_options_and_values(tmp_path: Path) -> None:
    pytest.importorskip("shtab")
    (tmp_path / "script").write_text("\n".join(page("completion", "bash")))
    asked = {"re": "replay", "run ap": "apartment", "run --laser.bea": "--laser.beams", "run --estimator isa": "isam2"}
    lines = ["source ./script"]
    for words in asked:
        *before, last = ["sixthsense", *words.split()]
        lines.append(f"COMP_WORDS=({' '.join([*before, last])}); COMP_CWORD={len(before)}")
        lines.append(f"_shtab_sixthsense sixthsense {last} {before[-1]}; echo ${{COMPREPLY[0]}}")
    done = subprocess.run(["bash", "-c", "\n".join(lines)], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.split()[:1] == ["replay"] or "report" in done.stdout
    assert done.stdout.split()[1:] == list(asked.values())[1:]


def test_every_option_can_be_completed() -> None:
    from sixthsense.cli.completion import options_of

    shown = {line.split()[0] for line in page("run", "--help", "all") if line.startswith("  --")}
    assert shown <= {f"--{option.name}" for option in options_of("run")}
    assert {"seeds", "workers", "laser.beams"} <= {option.name for option in options_of("campaign")}
    assert {"out", "animate"} <= {option.name for option in options_of("report")}


def at_a_terminal(code: str) -> str:
    """What a program writes to a terminal of 80 columns."""
    ours, theirs = pty.openpty()
    environment = os.environ | {"COLUMNS": "80", "TERM": "xterm-256color", "NO_COLOR": "1"}
    with subprocess.Popen([sys.executable, "-c", code], stdout=theirs, stderr=theirs, env=environment) as process:
        os.close(theirs)
        text = b""
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # the program has closed its end
                break
            if not part:
                break
            text += part
    os.close(ours)
    assert process.returncode is not None
    return text.decode()


def test_help_and_errors_at_a_terminal_have_no_colours() -> None:
    commands = [["--help"], ["run", "--help"], ["run", "--help", "all"], ["run", "nowhere"]]
    text = at_a_terminal(f"from sixthsense.cli import main\nfor args in {commands}: main(args)")
    assert "usage: sixthsense COMMAND" in text and "did you mean" not in text
    assert ESCAPE not in text


def test_the_defaults_in_the_help_are_those_of_the_configuration() -> None:
    text = " ".join(" ".join(page("run", "--help", "all")).split())
    found = re.search(r"--laser\.max-range X .*?\(default (\S+);", text)
    assert found is not None and float(found.group(1)) == Config().laser.max_range
