"""`verdict.json`, the verdict on the map of a run: written, and read back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import numpy as np

from sixthsense.config.errors import InputError, reason_of
from sixthsense.record.reading import checked
from sixthsense.record.writing import whole
from sixthsense.verdict.verdict import Cause, Level, Verdict


def write_verdict(file: Path, verdict: Verdict) -> None:
    """Write a verdict; stamps are seconds since the first scan, places metres in the world frame."""
    table = {
        "level": verdict.level,
        "probability": verdict.probability,
        "causes": [cause._asdict() | {"places": cause.places.tolist()} for cause in verdict.causes],
        "evidence": dict(verdict.evidence),
        "keyframes": verdict.keyframes.round(6).tolist(),
    }
    with whole(file) as unfinished:
        unfinished.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_verdict(file: Path) -> Verdict:
    """The verdict in a file; InputError for one that is damaged."""
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
        if table["level"] not in get_args(Level):
            raise ValueError(f"level {table['level']!r}")
        keyframes = checked("keyframes", np.array(table["keyframes"], dtype=np.float64), (-1,))
        causes = tuple(_cause(row) for row in table["causes"])
        evidence = {str(name): float(value) for name, value in table["evidence"].items()}
        return Verdict(table["level"], float(table["probability"]), keyframes, causes, evidence)
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})") from None
    except Exception as error:  # of a damaged file
        raise InputError(file, f"found {reason_of(error)}", "the verdict on a run") from None


def _cause(row: dict[str, Any]) -> Cause:
    places = np.array(row["places"], dtype=np.float64).reshape(-1, 2)
    return Cause(str(row["name"]), str(row["sentence"]), float(row["from_s"]), float(row["to_s"]), places)
