"""`Audit`, the result of `ss.audit`: its lines, the verdict in one sentence, its table, its figure and its page."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic_core import to_jsonable_python

from sixthsense.auditing.pairing import Align, Errors, TrajectoryErrors
from sixthsense.auditing.poses import POSITION, Frame
from sixthsense.auditing.statistics import AXES, LEAST_OF_A_PAIR, LEVELS, Findings, PairFindings
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.evaluation.consistency import Consistency, Outcome, short
from sixthsense.figures.canvas import in_millimetres, legend_above
from sixthsense.figures.overtime import draw_nees, draw_tube, scale_nees, style_of
from sixthsense.figures.plot import CYCLE, ESTIMATE, TRUTH, new_figure
from sixthsense.figures.report import Drawn, Text, Verdict, page, write_page

if TYPE_CHECKING:
    import pandas as pd

    from sixthsense.core.picture import Picture

_ALIGNED = {"none": "none: both are in one frame", "all": "by all poses"}


@dataclass(frozen=True, slots=True, repr=False)
class Audit:
    """An audit of covariances, as `ss.audit` returns it; it prints as its report.

    `verdict` is the answer in one sentence, `findings` has the numbers, `frame()` their table, `plot()` draws them,
    `save(file)` writes them as JSON, or as a page of HTML.
    """

    findings: Findings
    """NEES with its band, factors with their intervals, by axis; coverage"""
    runs: tuple[Errors, ...]
    """errors and covariances, after alignment"""
    axes_of: Frame
    """whose axes the covariances were read in"""
    align: Align
    """how the estimate was brought into the frame of the truth"""
    read_as: str
    """how the covariances were read, in words"""
    names: tuple[str, str]
    """of the estimate and of the truth"""
    notes: tuple[str, ...]
    """what a user should know, a line each"""
    trajectory: TrajectoryErrors | None
    """errors without covariances, as evo has them; None for a pair"""
    pair: PairFindings | None = None
    """what two systems say of each other, without a truth; `findings` are then those of their differences"""

    @property
    def outcome(self) -> Outcome:
        """consistent, overconfident, cautious, or too short to tell; of a pair whether at least one of the two is."""
        return self.findings.outcome if self.pair is None else self.pair.outcome

    @property
    def verdict(self) -> str:
        """The answer in one sentence."""
        if self.pair is not None:
            return _of_pair(self.findings, self.pair, self.names)
        return f"{self.findings.pose}{_where(self.findings)}"

    def frame(self) -> pd.DataFrame:
        """A row for the pose and for each axis: NEES, samples, factor of the covariance with its interval, outcome."""
        import pandas as pd

        each = {"pose": self.findings.pose, **self.findings.axes}
        rows = [(one.nees, one.samples, one.factor, *one.interval, one.outcome) for one in each.values()]
        frame = pd.DataFrame(rows, list(each), ["nees", "samples", "factor", "factor_low", "factor_high", "outcome"])
        frame.attrs["units"] = dict.fromkeys(frame.columns[:-1], "1")
        return frame

    def __repr__(self) -> str:
        return "\n".join(f"{label:12} {text}" for label, text in [*self._lines(), ("verdict", self.verdict)])

    def _lines(self) -> Iterator[tuple[str, str]]:
        """Label and text of each line but the verdict."""
        found = self.findings
        yield "covariance", self.read_as
        yield "poses", f"{found.poses:,} of {self.names[0]}, worth {short(found.pose.samples)} independent ones"
        yield ("truth" if self.pair is None else "pair"), self.names[1]
        taken = f"; {100.0 * found.removed:.2g} % of the errors' squares taken off" if self.align == "all" else ""
        yield "alignment", _ALIGNED[self.align] + taken
        ratios = {name: map(short, (math.sqrt(one.factor), *one.sigmas)) for name, one in found.axes.items()}
        words = (f"{name} {ratio} ({low} to {high})" for name, (ratio, low, high) in ratios.items())
        yield "by axis", f"errors over stated sigmas: {', '.join(words)}"
        low, high = found.pose.interval
        yield "factor", f"{short(found.factor)} for the covariance, {short(low)} to {short(high)} with 95 %"
        if self.pair is not None:
            told = ", ".join(f"{100.0 * chance:.0f} % for {times:g} times" for times, chance in self.pair.power.items())
            yield "power", f"one whose errors are larger than its sigmas is found with {told}"
            yield "dependence", "errors that both share, as by one odometry or the same scans, cancel: they hide"
        levels, shares = (", ".join(f"{100.0 * one:.0f}" for one in of) for of in (LEVELS, found.coverage.values()))
        yield "coverage", f"inside the regions of {levels} %: {shares}"
        if self.trajectory is not None:
            yield "trajectory", f"ATE {self.trajectory.ate_m:.3f} m, {self.trajectory.aligned_ate_m:.3f} m aligned"
        yield from (("note", note) for note in self.notes)

    def as_dict(self) -> dict[str, Any]:
        """All numbers and texts, as in the JSON file; a number that is not known is None."""
        names = ["verdict", "outcome", "align", "read_as", "notes", "findings", "trajectory", "pair"]
        known = {name: getattr(self, name) for name in names} | {"text": repr(self), "frame": self.axes_of}
        known |= {"estimate": self.names[0], "truth": self.names[1], "runs": len(self.runs)}
        found: dict[str, Any] = to_jsonable_python(known, inf_nan_mode="null")
        pose = self.findings.pose
        found["findings"] |= {"band": list(pose.band), "interval": list(pose.interval)}
        return found

    def save(self, file: str | Path) -> None:
        """Write the numbers as JSON, or a page for a file that ends in .html; InputError if it cannot be written."""
        if Path(file).suffix != ".html":
            write_page(Path(file), json.dumps(self.as_dict(), indent=2, ensure_ascii=False) + "\n")
            return
        with tempfile.TemporaryDirectory() as folder:
            picture = Path(folder) / "audit.png"
            self.plot().savefig(picture, dpi=110)
            caption = "Errors of the first run in their 3-sigma tubes, NEES over time, chi-square Q-Q."
            lines = Text("\n".join(f"{label:12} {text}" for label, text in self._lines()))
            sections: dict[str, list[Any]] = {"What it rests on": [lines], "Figures": [Drawn(picture, caption)]}
            sections["Table"] = [self.frame().round(4)]
            verdict = Verdict("", self.verdict, self.outcome == "overconfident")
            write_page(Path(file), page(f"Audit of {self.names[0]}", [verdict], sections))

    def plot(self) -> Picture:
        """The errors of the first run in their 3-sigma tubes, the NEES with its band, and a chi-square Q-Q diagram."""
        names, run = AXES[self.axes_of, self.findings.pose.dof], self.runs[0]
        picture = new_figure(11.0, 2.2 + 1.65 * len(names))
        grid = picture.add_gridspec(2 * len(names), 2, width_ratios=(1.25, 1.0))
        error, cov = run.in_axes(self.axes_of)
        tubes: list[Any] = []
        for k, name in enumerate(names):
            ax = picture.add_subplot(grid[2 * k : 2 * k + 2, 0], sharex=tubes[0] if tubes else None)
            scale, unit = (1.0, "m") if k < POSITION[len(names)] else (float(np.degrees(1.0)), "°")
            bound = 3.0 * scale * np.sqrt(cov[:, k, k])
            draw_tube(ax, _seconds(run), scale * error[:, k], bound, "stated ±3σ", color=ESTIMATE, label="error")  # noqa: RUF001
            ax.set_ylabel(f"{name} [{unit}]")
            ax.tick_params(labelbottom=k == len(names) - 1)
            tubes.append(ax)
        tubes[-1].set_xlabel("time [s]")
        legend_above(tubes[0])
        ax = picture.add_subplot(grid[: len(names), 1])
        for k, one in enumerate(self.runs):
            draw_nees(ax, _seconds(one), one.nees, self.findings.pose, style=style_of(k))
        scale_nees(ax, [one.nees for one in self.runs], [self.findings.pose])
        legend_above(ax)
        _draw_quantiles(picture.add_subplot(grid[len(names) :, 1]), self.runs, self.findings.pose)
        picture.suptitle(self.verdict, fontsize=11.0, wrap=True)
        for ax in picture.axes:
            in_millimetres(ax)
        return picture


def _of_pair(found: Findings, pair: PairFindings, names: tuple[str, str]) -> str:
    """What two systems say of each other in one sentence."""
    first, second = (f"the {one}" if one in ("first", "second") else Path(one.split()[0]).name for one in names)
    if pair.outcome == "too short to tell":
        worth = f"worth {short(pair.samples)} independent samples, {LEAST_OF_A_PAIR:.0f} are needed"
        return f"too short to tell: {found.poses:,} poses are {worth}"
    if pair.outcome == "consistent":
        return "consistent: the two differ by as much as both covariances allow; an error that both share is not seen"
    if pair.outcome == "cautious":
        less = f"the two differ by {short(math.sqrt(found.factor))} times what independent systems would"
        return f"{less}: at least one is cautious, or their errors depend on each other"
    each = [short(times) for times in pair.if_other_honest]
    if_honest = f"if {second} is honest, {first} by {each[0]}; if {first} is, {second} by {each[1]}"
    return f"at least one is overconfident by {short(pair.least)} or more: {if_honest}"


def _where(found: Findings) -> str:
    """The axes that are off as the pose is, mostly those beyond the typical one; of a consistent pose those off."""
    if found.outcome == "consistent":
        alone = found.deviating()
        return f"; yet not in {_listed(alone)}" if alone else ""
    some = [name for name, one in found.axes.items() if one.outcome == found.outcome != "too short to tell"]
    typical = math.exp(sum(math.log(max(one.factor, 1e-300)) for one in found.axes.values()) / len(found.axes))
    is_more = 1.0 if found.outcome == "overconfident" else -1.0
    if most := [name for name in some if min(is_more * (end - typical) for end in found.axes[name].interval) > 0.0]:
        return f", mostly in {_listed(most)}"
    return "" if not some else ", on all axes" if len(some) == len(found.axes) else f", in {_listed(some)}"


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _draw_quantiles(ax: Any, runs: Sequence[Errors], found: Consistency) -> None:
    """Draw the quantiles of the NEES against those of chi-square: consistent errors lie on the diagonal."""
    nees = np.sort(np.concatenate([run.nees for run in runs]))
    end = float(chi_square_quantile(0.999, found.dof))
    shares: Any = (np.arange(len(nees)) + 0.5) / len(nees)
    expected = chi_square_quantile(shares, found.dof)
    ax.plot(expected, nees, color=ESTIMATE, linewidth=1.4, label="poses")
    ax.plot([0.0, end], [0.0, end], color=TRUTH, linewidth=0.8, linestyle="--", label="consistent")
    label = f"covariance times {found.factor:.2f}"
    ax.plot([0.0, end], [0.0, found.factor * end], color=CYCLE[1], linewidth=0.9, label=label)
    ax.set(xlim=(0.0, end), ylim=(0.0, 1.15 * end * max(1.0, found.factor)))
    ax.set(xlabel=f"quantile of chi-square with {found.dof} degrees of freedom [1]", ylabel="quantile of NEES [1]")
    ax.legend(frameon=False, loc="upper left", fontsize="small")


def _seconds(run: Errors) -> Any:
    return 1e-9 * (run.stamps_ns - run.stamps_ns[0])
