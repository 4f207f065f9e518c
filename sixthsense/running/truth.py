"""The audit of a replayed run by a truth that its log has not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sixthsense.auditing.result import Audit
    from sixthsense.figures.run import Run


@dataclass(frozen=True, slots=True)
class Truth:
    """Where the true poses are, in a frame and on a clock of their own."""

    file: Path
    """a bag, a TUM file, or the folder of a run"""
    topic: str = ""
    """in a bag; by default the only one with poses"""
    frames: tuple[str, str] | None = None
    """parent and child in /tf"""
    offset_s: float | None = None
    """largest offset of the clocks to search; None: none is"""

    def check(self) -> None:
        """Raise InputError if the poses cannot be read."""
        import numpy as np

        from sixthsense.auditing.opening import Options, open_truth
        from sixthsense.auditing.poses import Poses

        run = Poses("the run", np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)))
        options = Options(truth_topic=self.topic, truth_frames=self.frames, time_offset=self.offset_s)
        open_truth(self.file, run, run.name, options)


def audit_of_run(run: Run, truth: Truth) -> Audit:
    """The audit of a run's keyframes, aligned by all poses; `audit.json` and `figures/audit.png` go to its folder."""
    from sixthsense.auditing.call import audit

    found = audit(
        run, truth.file, truth_topic=truth.topic, truth_frames=truth.frames, align="all", time_offset=truth.offset_s
    )
    if run.folder is not None:
        found.save(run.folder / "audit.json")
        found.plot().savefig(run.folder / "figures" / "audit.png", dpi=150)
    return found
