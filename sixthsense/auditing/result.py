"""`Audit`, the result of `ss.audit`, and how it is told: its lines, the verdict in one sentence, and its figure."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.auditing.pairing import Align, Errors
from sixthsense.auditing.pairs import LEAST_OF_A_PAIR, PairFindings
from sixthsense.auditing.poses import Frame
from sixthsense.auditing.scores import LEVELS, Score, TrajectoryErrors
from sixthsense.auditing.statistics import AXES, Factor, Findings, Outcome, factor
from sixthsense.config.errors import InputError
from sixthsense.core.covariance import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.core.source import seconds
from sixthsense.evaluation.effective import LEAST_SAMPLES
from sixthsense.figures.canvas import in_millimetres
from sixthsense.figures.overtime import BAND, draw_tube
from sixthsense.figures.plot import CYCLE, ESTIMATE, TRUTH, new_figure

if TYPE_CHECKING:
    from sixthsense.core.picture import Picture

_ALIGNED = {
    "none": "none: both are in one frame",
    "first": "by the first pose, whose covariance is carried to the others",
    "all": "by all poses",
}
_FRAMES = {"world": "the world's axes, rotations about fixed axes", "body": "the body's axes"}
_WIDTH_IN, _HEIGHT_IN, _PER_AXIS_IN = 11.0, 2.2, 1.65
_MOST_POINTS = 4000  # of a curve; more are not to be seen
_SURE = 0.6  # share of the variance of the mean from which on the first pose alone forbids a verdict


@dataclass(frozen=True, slots=True, repr=False)
class Audit:
    """An audit of covariances, as `ss.audit` returns it; it prints as its report.

    `verdict` is the answer in one sentence, `findings` has the numbers, `plot()` draws them, `save(file)` writes them
    as JSON.
    """

    findings: Findings
    """NEES with its band, factors with their intervals, by axis and over time"""
    scores: dict[str, Score]
    """coverage and log score of `pose`, `position` and `rotation`"""
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
    trajectory: TrajectoryErrors | None
    """errors without covariances, as evo has them; None for a pair"""
    pair: PairFindings | None = None
    """what two systems say of each other, without a truth; `findings` are then those of their differences"""

    @property
    def outcome(self) -> Outcome:
        """consistent, overconfident, cautious, or no verdict; of a pair whether at least one of the two is."""
        return self.findings.outcome if self.pair is None else self.pair.outcome

    @property
    def verdict(self) -> str:
        """The answer in one sentence."""
        return _sentence(self.findings) if self.pair is None else _pair_sentence(self.findings, self.pair, self.names)

    def __repr__(self) -> str:
        rows = [("covariance", self.read_as), *_lines(self.findings, self.align, self.names)]
        if self.pair is not None:
            rows = [("pair" if label == "truth" else label, text) for label, text in rows]
            rows += _pair_lines(self.pair, self.names)
        rows += [("coverage", _coverage(self.scores)), ("log score", _log_score(self.scores["pose"]))]
        if self.trajectory is not None:
            rows.append(("trajectory", _trajectory(self.trajectory)))
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
                "text": repr(self),
                "verdict": self.verdict, "outcome": self.outcome, "read_as": self.read_as, "frame": self.frame,
                "align": self.align, "estimate": self.names[0], "truth": self.names[1], "pair": None,
                "time_offset_s": self.time_offset_s, "runs": len(self.runs), **numbers,
                "scores": {name: asdict(one) for name, one in self.scores.items()},
                "trajectory": None if self.trajectory is None else asdict(self.trajectory), "notes": self.notes,
            }
        )  # fmt: skip
        if self.pair is not None:
            known |= {"truth": None, "pair": _finite(asdict(self.pair)) | {"name": self.names[1]}}
        return known

    def save(self, file: str | Path) -> None:
        """Write the numbers as JSON; InputError if the file cannot be written."""
        try:
            Path(file).write_text(json.dumps(self.as_dict(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(file, f"cannot be written ({error.strerror})", "a file") from None

    def plot(self) -> Picture:
        """The errors of the first run in their 3-sigma tubes, the NEES with its band, and a chi-square Q-Q diagram."""
        return _drawn(self.runs, self.findings, self.frame, self.verdict)


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


def _worth(poses: int, samples: float) -> str:
    return f"{poses:,} poses are worth {_short(samples)} independent ones"


def _reason(found: Findings) -> str:
    worth = f"{_worth(found.poses, found.samples)}, {LEAST_SAMPLES:.0f} are needed"
    if found.shared * found.samples > _SURE:
        return f"{worth}: all depend on the first pose; align by all poses"
    if found.nees > float(chi_square_quantile(0.999, found.dof)):
        return (
            f"{worth}; yet a NEES of {_short(found.nees)} is not chance: look for an error that stays, such as another "
            "frame (align by all poses), a time offset, or a mount"
        )
    return f"{worth}: errors last too long for so short a time; audit more or longer runs"


def _pair_sentence(found: Findings, pair: PairFindings, names: tuple[str, str]) -> str:
    """What two systems say of each other in one sentence."""
    first, second = (Path(name.split()[0]).name for name in names)
    first, second = (f"the {name}" if name in ("first", "second") else name for name in (first, second))
    if pair.outcome == "no verdict":
        return f"no verdict: {_worth(found.poses, pair.samples)}, {LEAST_OF_A_PAIR:.0f} are needed"
    if pair.outcome == "consistent":
        return "consistent: the two differ by as much as both covariances allow; an error that both share is not seen"
    if pair.outcome == "cautious":
        low = math.sqrt(found.factor.value)
        return (
            f"the two differ by {_short(low)} times what independent systems would: at least one is cautious, or their "
            "errors depend on each other"
        )
    each = [_short(times) for times in pair.if_other_honest]
    return (
        f"at least one is overconfident by {_short(pair.least)} or more: if {second} is honest, {first} by {each[0]}; "
        f"if {first} is, {second} by {each[1]}"
    )


def _pair_lines(pair: PairFindings, names: tuple[str, str]) -> Iterator[tuple[str, str]]:
    """Label and text of what is told of a pair alone."""
    told = ", ".join(f"{100.0 * chance:.0f} % for {times:g} times" for times, chance in pair.power.items())
    yield "power", f"one whose errors are larger than its sigmas is told with {told} (simulated)"
    ratios = ", ".join(f"{_short(seconds)} s {_short(ratio)}" for seconds, ratio in pair.horizons)
    yield "horizons", f"differences of motions over what independent ends allow: {ratios}"
    for name, hat in zip((names[0], *names[1].split(" and ")), pair.hats, strict=False):
        low, high = hat.interval
        negative = "; negative: the other two depend on each other" if high < 0.0 else ""
        yield "own factor", f"{name}: {hat.factor:.2f} ({low:.2f} to {high:.2f}), three-cornered hat{negative}"
    yield "dependence", "errors that both share, as by one odometry or the same scans, cancel: they hide, never feign"


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
    ratios = (f"{name} {_ratio(one)}" for name, one in found.axes.items())
    yield "by axis", f"errors over stated sigmas: {', '.join(ratios)}"
    parts = ", ".join("-" if math.isnan(part) else _short(part) for part in found.parts)
    yield "over time", f"NEES in {len(found.parts)} equal parts: {parts}"
    low, high = found.factor.interval
    yield "factor", f"{_short(found.factor.value)} for the covariance, {_short(low)} to {_short(high)} with 95 %"


def _coverage(scores: dict[str, Score]) -> str:
    """What lies inside the regions of the levels."""
    levels = ", ".join(f"{100.0 * level:.0f}" for level in LEVELS)
    shares = (
        f"{name} {', '.join(f'{100.0 * share:.0f}' for share in one.coverage.values())} (of {_short(one.samples)})"
        for name, one in scores.items()
    )
    return f"inside the regions of {levels} %: {'; '.join(shares)}"


def _log_score(one: Score) -> str:
    return f"{one.log_score:.2f} nats on average; {one.scaled_log_score:.2f} with the covariance times the factor"


def _trajectory(errors: TrajectoryErrors) -> str:
    return (
        f"ATE {errors.ate_m:.3f} m, {errors.aligned_ate_m:.3f} m aligned; from pose to pose RPE {errors.rpe_m:.4f} m, "
        f"{errors.rpe_deg:.3f}°"
    )


def _ratio(one: Factor) -> str:
    low, high = one.sigmas
    return f"{_short(math.sqrt(one.value))} ({_short(low)} to {_short(high)})"


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _short(value: float) -> str:
    """Three digits at most, without an exponent."""
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}" if value >= 10.0 else f"{value:.2f}"


def _drawn(runs: Sequence[Errors], found: Findings, frame: Frame, title: str) -> Picture:
    """Errors of the first run in their tubes at the left; NEES over time and chi-square Q-Q at the right."""
    names = AXES[frame, found.dof]
    picture = new_figure(_WIDTH_IN, _HEIGHT_IN + _PER_AXIS_IN * len(names))
    grid = picture.add_gridspec(2 * len(names), 2, width_ratios=(1.25, 1.0))
    tubes: list[Any] = []
    for k, name in enumerate(names):
        tubes.append(picture.add_subplot(grid[2 * k : 2 * k + 2, 0], sharex=tubes[0] if tubes else None))
        _draw_axis(tubes[-1], runs[0], frame, k, name)
        tubes[-1].tick_params(labelbottom=k == len(names) - 1)
    tubes[-1].set_xlabel("time [s]")
    tubes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, borderaxespad=0.2)
    _draw_nees(picture.add_subplot(grid[: len(names), 1]), runs, found)
    _draw_quantiles(picture.add_subplot(grid[len(names) :, 1]), runs, found)
    picture.suptitle(title, fontsize=11.0)
    for ax in picture.axes:
        in_millimetres(ax)
    return picture


def _draw_axis(ax: Any, run: Errors, frame: Frame, axis: int, name: str) -> None:
    """Draw the error on one axis of a frame with the stated +-3 sigma."""
    rows = _some(len(run.stamps_ns))
    error, cov = run.in_axes(frame)
    scale, unit = (1.0, "m") if axis < run.orientations.shape[1] else (float(np.degrees(1.0)), "°")
    bound = 3.0 * scale * np.sqrt(cov[rows, axis, axis])
    style: dict[str, Any] = {"color": ESTIMATE, "label": "error"}
    draw_tube(ax, _seconds(run)[rows], scale * error[rows, axis], bound, "stated ±3σ", **style)  # noqa: RUF001
    ax.set_ylabel(f"{name} [{unit}]")


def _draw_nees(ax: Any, runs: Sequence[Errors], found: Findings) -> None:
    """Draw the NEES of each pose, the means of equal parts of the time, and the band of the mean."""
    label: str | None = f"NEES: mean {found.nees:.3g}, {100.0 * found.inside:.0f} % inside 95 %"
    for k, run in enumerate(runs):
        rows = _some(len(run.stamps_ns))
        style = {"color": CYCLE[k % len(CYCLE)], "linewidth": 0.5, "alpha": 0.45}
        ax.plot(_seconds(run)[rows], run.nees[rows], label=label, **style)
        label = None
    end = max(float(_seconds(run)[-1]) for run in runs)
    edges = np.linspace(0.0, end, len(found.parts) + 1)
    ax.stairs(np.array(found.parts), edges, baseline=None, color=TRUTH, linewidth=1.6, label="mean of each part")
    ax.axhspan(*found.band, label="95 % band of the mean", **BAND)
    ax.set_yscale("log")
    together = np.concatenate([run.nees for run in runs])
    ax.set_ylim(max(float(np.percentile(together, 1.0)), 0.02), 1.5 * max(float(together.max()), 2.0 * found.band[1]))
    ax.set(xlabel="time [s]", ylabel="NEES [1]")
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    ax.legend(frameon=False, ncols=2, fontsize="small", **above)
    ax.margins(x=0.0)


def _draw_quantiles(ax: Any, runs: Sequence[Errors], found: Findings) -> None:
    """Draw the quantiles of the NEES against those of chi-square: consistent errors lie on the diagonal."""
    nees = np.sort(np.concatenate([run.nees for run in runs]))
    shares = (np.arange(len(nees)) + 0.5) / len(nees)
    rows = _some(len(nees))
    expected = chi_square_quantile(shares[rows], found.dof)
    ax.plot(expected, nees[rows], color=ESTIMATE, linewidth=1.4, label="poses")
    end = float(chi_square_quantile(0.999, found.dof))
    ax.plot([0.0, end], [0.0, end], color=TRUTH, linewidth=0.8, linestyle="--", label="consistent")
    factor = found.factor.value
    ax.plot([0.0, end], [0.0, factor * end], color=CYCLE[1], linewidth=0.9, label=f"covariance times {factor:.2f}")
    ax.set(xlim=(0.0, end), ylim=(0.0, 1.15 * max(end, factor * end)))
    ax.set(xlabel=f"quantile of chi-square with {found.dof} degrees of freedom [1]", ylabel="quantile of NEES [1]")
    ax.legend(frameon=False, loc="upper left", fontsize="small")


def _some(count: int) -> Any:
    """Indices of the points of a curve, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, _MOST_POINTS).astype(np.int64))


def _seconds(run: Errors) -> Array:
    return np.asarray(seconds(run.stamps_ns - run.stamps_ns[0]))
