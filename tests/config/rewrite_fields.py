"""Write `sixthsense/config/fields.pyi`, the fields that calls take by name, from the configuration's models.

python tests/config/rewrite_fields.py
"""

import typing
from collections.abc import Iterator
from pathlib import Path

from sixthsense.config import Config, Section
from sixthsense.config.parts import KINDS, OF_THE_ROBOT
from sixthsense.config.section import kind_of

FILE = Path(__file__).parents[2] / "sixthsense" / "config" / "fields.pyi"
PARTS = [parts.kind for parts in KINDS]
PRIOR_MAP = {"pose": "Sequence[float]", "pose_sigma": "Sequence[float]", "lost": "bool"}
HEAD = '''\
"""The fields that `ss.run` and its kin take by name; written by tests/config/rewrite_fields.py."""
# ruff: noqa: F403, F405

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict

from sixthsense.config.sections import *

Table = Mapping[str, Any]
PartName = str | Callable[..., Any]
'''


def type_of(name: str, of: str = "PartName") -> str:
    """What a call takes for a field of the configuration."""
    field = Config.model_fields[name]
    kind, _ = kind_of(field)
    absent = " | None" if type(None) in typing.get_args(field.annotation) else ""
    if name in PARTS:
        return of
    if isinstance(kind, type) and issubclass(kind, Section):
        return f"{kind.__name__} | Table"
    if typing.get_origin(kind) is tuple:
        inner = typing.get_args(kind)[0]
        return ("Sequence[Sequence[float]]" if typing.get_origin(inner) is tuple else "Sequence[float]") + absent
    if typing.get_origin(kind) is typing.Literal:
        return f"Literal{list(typing.get_args(kind))}".replace("'", '"') + absent
    return ("Table" if typing.get_origin(kind) is dict else kind.__name__) + absent


def call(name: str, fields: dict[str, str]) -> Iterator[str]:
    """The lines of the type of a call's arguments."""
    yield from ("", f"class {name}(TypedDict, total=False):", *(f"    {one}: {kind}" for one, kind in fields.items()))


def text() -> str:
    """The whole file."""
    of_preset = {name: type_of(name) for name in Config.model_fields}
    of_run = {name: kind for name, kind in of_preset.items() if name != "scene"}
    of_replay = {name: kind for name, kind in of_run.items() if name not in (*OF_THE_ROBOT, "map_unknown", "robot")}
    of_merge = {name: kind for name, kind in of_replay.items() if name != "preset"}
    of_campaign = {name: type_of(name, "PartName | Sequence[PartName]") for name in of_run if name != "seed"}
    of_campaign["preset"] = "str | Sequence[str]"
    lines = [
        *call("Fields", of_preset),
        *call("RunFields", of_run | PRIOR_MAP),
        *call("MergeFields", of_merge),
        *call("ReplayFields", of_replay | PRIOR_MAP),
        *call("CampaignFields", of_campaign),
    ]
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    FILE.write_text(text())
