"""The typed dictionaries of keyword arguments say what the configuration takes."""

import inspect
import subprocess
import sys
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import pytest

import sixthsense as ss
from sixthsense.config import Section, fields, section_fields

CALLS = {
    ss.run: fields.RunFields,
    ss.replay: fields.ReplayFields,
    ss.merge_runs: fields.MergeFields,
    ss.campaign: fields.CampaignFields,
}


def argument(hint: Any) -> Any:
    """The type of an argument that sets a field of this type."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return argument(args[0])
    if origin is tuple:
        return Sequence[argument(args[0])]
    if origin in (typing.Union, types.UnionType):
        return typing.Union[tuple(map(argument, args))]  # noqa: UP007
    if isinstance(hint, type) and issubclass(hint, Section):
        return getattr(section_fields, f"{hint.__name__.removesuffix('Config')}Fields")
    return hint


def arguments(section: type) -> dict[str, Any]:
    hints = typing.get_type_hints(section, include_extras=True)
    return {name: argument(hint) for name, hint in hints.items()}


def sections(section: type) -> set[type]:
    below = [hint for hint in typing.get_type_hints(section).values() if isinstance(hint, type)]
    return {section}.union(*(sections(one) for one in below if issubclass(one, Section)))


def test_the_typed_fields_are_those_of_the_configuration() -> None:
    assert typing.get_type_hints(fields.Fields) == arguments(ss.Config)
    for section in sections(ss.Config) - {ss.Config}:
        assert typing.get_type_hints(argument(section)) == arguments(section), section


def test_every_call_takes_typed_fields_that_it_knows() -> None:
    known = {*typing.get_type_hints(ss.Config), "pose", "pose_sigma", "lost"}
    for call, taken in CALLS.items():
        assert inspect.signature(call).parameters["fields"].annotation == f"Unpack[{taken.__name__}]"
        assert set(typing.get_type_hints(taken)) <= known
    assert {"task", "goal", "start", "world", "robot"}.isdisjoint(typing.get_type_hints(fields.ReplayFields))


@pytest.mark.slow
def test_a_type_checker_rejects_a_misspelt_field(tmp_path: Path) -> None:
    lines = [
        "import sixthsense as ss",
        'ss.run("apartment", estimator="ekf", laser={"beams": 90}, goal=(1, 2.5), max_time=None)',
        'ss.run("apartment", estimatr="ekf")',
        'ss.run("apartment", laser={"beam": 90})',
        'ss.replay("a.log", robot=3, front_end="landmarks")',
        'ss.replay("a.log", seed="3")',
        'ss.preset("worn", estimatr="ekf")',
        'ss.campaign("apartment", seeds=range(3), out="c", estimator=["ekf", "isam2"])',
        'ss.campaign("apartment", seeds=range(3), out="c", estimatr=["ekf", "isam2"])',
        'ss.run("apartment").plot("error", over="distance").savefig("a.png")',
    ]
    (tmp_path / "snippet.py").write_text("\n".join(lines))
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path / "cache"), "snippet.py"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False).stdout
    found = [line.split(":")[1] for line in said.splitlines() if ": error: " in line]
    assert found == ["3", "4", "6", "7", "9"], said
    assert 'Unexpected keyword argument "estimatr" for "run"; did you mean "estimator"?' in said
