"""`Audit`, the result of `ss.audit`, and how it is told: its lines, and the verdict in one sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.auditing.pairing import Align, Errors
from sixthsense.auditing.poses import AuditError, Frame
from sixthsense.auditing.statistics import AXES, Factor, Findings, Outcome, factor
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.evaluation.effective import LEAST_SAMPLES

if TYPE_CHECKING:
    from sixthsense.figures.picture import Picture


_ALIGNED = {
    "none": "none: both are in one frame",
    "first": "by the first pose, whose covariance is carried to the others",
    "all": "by all poses",
}
_FRAMES = {"world": "the world's axes, rotations about fixed axes", "body": "the body's axes"}
_SURE = 0.6  # share of the variance of the mean from which on the first pose alone forbids a verdict


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
        return _sentence(self.findings)

    def __repr__(self) -> str:
        rows = [("covariance", self.read_as), *_lines(self.findings, self.align, self.names)]
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


def read_as(frame: Frame, dof: int, order: str, by_format: bool) -> str:
    """How the covariances were read: whose axes, and which half is first."""
    space = f"SE({2 if dof == 3 else 3}): {', '.join(AXES[frame, dof])}"
    origin = " (the convention of ROS)" if by_format else ""
    return f"in {_FRAMES[frame]}{origin}; {order} first; {space}"


def _sentence(found: Findings) -> str:
    """The verdict in one sentence."""
    outcome = found.outcome
    if outcome == "no verdict":
        return f"no verdict: {_reason(found)}"
    low, high = found.factor.sigmas
    where = "" if outcome == "consistent" else _where(found)
    return f"{outcome}: errors are {_short(low)} to {_short(high)} times the stated sigmas{where}"


def _reason(found: Findings) -> str:
    worth = f"{found.poses:,} poses are worth {_short(found.samples)} independent ones, {LEAST_SAMPLES:.0f} are needed"
    if found.shared * found.samples > _SURE:
        return f"{worth}: all depend on the first pose; align by all poses"
    if found.nees > float(chi_square_quantile(0.999, found.dof)):
        return (
            f"{worth}; yet a NEES of {_short(found.nees)} is not chance: look for an error that stays, such as another "
            "frame (align by all poses), a time offset, or a mount"
        )
    return f"{worth}: errors last too long for so short a time; audit more or longer runs"


def _where(found: Findings) -> str:
    """The axes on which the errors are farther from the stated sigmas than on the others."""
    sign = 1.0 if found.outcome == "overconfident" else -1.0
    typical = math.exp(sum(math.log(max(one.value, 1e-300)) for one in found.axes.values()) / len(found.axes))

    def beyond(one: Factor, value: float) -> bool:
        return sign * (one.interval[0 if sign > 0.0 else 1] - value) > 0.0

    most = [name for name, one in found.axes.items() if beyond(one, 1.0) and beyond(one, max(typical, 1e-300))]
    if most:
        return f", mostly in {_listed(most)}"
    some = [name for name, one in found.axes.items() if beyond(one, 1.0)]
    return "" if not some else ", on all axes" if len(some) == len(found.axes) else f", in {_listed(some)}"


def axis_notes(found: Findings) -> Iterator[str]:
    """The axes that deviate although the whole does not, each with a chance of 5 % over their number."""
    if found.outcome != "consistent":
        return
    for name, one in found.axes.items():
        if one.samples < LEAST_SAMPLES:
            continue
        # Three normal sigmas stand for 5 % over at most six axes.
        wide = factor(one.value, one.samples * (1.96 / 2.64) ** 2, 1).interval
        if not wide[0] <= 1.0 <= wide[1]:
            low, high = (math.sqrt(limit) for limit in one.interval)
            yield f"{name} alone: errors are {_short(low)} to {_short(high)} times the stated sigma"


def _lines(found: Findings, align: Align, names: tuple[str, str]) -> Iterator[tuple[str, str]]:
    """Label and text of each line, without the first and without the notes and the verdict."""
    yield "poses", f"{found.poses:,} of {names[0]}"
    yield "truth", names[1]
    taken = f"; {100.0 * found.removed:.2g} % of the errors' squares taken off" if align == "all" else ""
    yield "alignment", _ALIGNED[align] + taken
    yield "samples", f"{found.poses:,} correlated poses are worth {_short(found.samples)} independent ones"
    low, high = found.band
    yield "NEES", f"{_short(found.nees)} on average; {_short(low)} to {_short(high)} is consistent"
    yield "inside 95 %", f"{100.0 * found.inside:.1f} % of the poses"
    ratios = (f"{name} {_ratio(one)}" for name, one in found.axes.items())
    yield "by axis", f"errors over stated sigmas: {', '.join(ratios)}"
    parts = ", ".join("-" if math.isnan(part) else _short(part) for part in found.parts)
    yield "over time", f"NEES in {len(found.parts)} equal parts: {parts}"
    low, high = found.factor.interval
    yield "factor", f"{_short(found.factor.value)} for the covariance, {_short(low)} to {_short(high)} with 95 %"


def _ratio(one: Factor) -> str:
    low, high = one.sigmas
    return f"{_short(math.sqrt(one.value))} ({_short(low)} to {_short(high)})"


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _short(value: float) -> str:
    """Three digits at most, without an exponent."""
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}" if value >= 10.0 else f"{value:.2f}"
