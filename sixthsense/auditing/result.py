"""`Audit`, the result of `ss.audit`."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.auditing import wording
from sixthsense.auditing.pairing import Align, Errors
from sixthsense.auditing.poses import AuditError, Frame
from sixthsense.auditing.statistics import Findings, Outcome

if TYPE_CHECKING:
    from sixthsense.figures.picture import Picture


@dataclass(frozen=True, slots=True, repr=False)
class Audit:
    """An audit of covariances, as `ss.audit` returns it; it prints as its report.

    `verdict` is the answer in one sentence, `findings` has the numbers, `plot()` draws them, `save(file)` writes them
    as JSON.
    """

    findings: Findings
    """NEES with its band, factors with their intervals, by axis and over time"""
    runs: tuple[Errors, ...]
    """errors and covariances, after alignment"""
    frame: Frame
    """whose axes the covariances were read in"""
    align: Align
    """how the estimate was brought into the frame of the truth"""
    read_as: str
    """how the covariances were read, in words"""
    names: tuple[str, str]
    """of the estimate and of the truth"""
    time_offset_s: tuple[float, ...] | None
    """seconds added to the stamps of each estimate; None if no offset was searched"""
    notes: tuple[str, ...]
    """what a user should know, a line each"""

    @property
    def outcome(self) -> Outcome:
        """consistent, overconfident, cautious, or no verdict."""
        return self.findings.outcome

    @property
    def verdict(self) -> str:
        """The answer in one sentence."""
        return wording.sentence(self.findings)

    def __repr__(self) -> str:
        rows = [("covariance", self.read_as), *wording.lines(self.findings, self.align, self.names)]
        if self.time_offset_s is not None:
            shown = ", ".join(f"{1e3 * offset:+.1f} ms" for offset in self.time_offset_s)
            rows.append(("time offset", f"{shown} added to the stamps of the estimate"))
        rows += [("note", note) for note in self.notes] + [("verdict", self.verdict)]
        return "\n".join(f"{label:12} {text}" for label, text in rows)

    def as_dict(self) -> dict[str, Any]:
        """All numbers and texts, as in the JSON file; a number that is not known is None."""
        numbers = asdict(self.findings)
        known: dict[str, Any] = _finite(
            {
                "verdict": self.verdict, "outcome": self.outcome, "read_as": self.read_as, "frame": self.frame,
                "align": self.align, "estimate": self.names[0], "truth": self.names[1],
                "time_offset_s": self.time_offset_s, "runs": len(self.runs), **numbers, "notes": self.notes,
            }
        )  # fmt: skip
        return known

    def save(self, file: str | Path) -> None:
        """Write the numbers as JSON; AuditError if the file cannot be written."""
        try:
            Path(file).write_text(json.dumps(self.as_dict(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise AuditError(f"{file}: cannot be written ({error.strerror}), allowed: a file") from None

    def plot(self) -> Picture:
        """The errors of the first run in their 3-sigma tubes, the NEES with its band, and a chi-square Q-Q diagram."""
        from sixthsense.auditing.figure import draw

        return draw(self.runs, self.findings, self.frame, self.verdict)


def _finite(value: Any) -> Any:
    """The value with lists for tuples and None for what is not finite, as JSON has them."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
