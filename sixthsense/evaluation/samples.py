"""A finished run as one of several that are compared."""

from __future__ import annotations

from typing import Any

from sixthsense.evaluation.curves import curves
from sixthsense.evaluation.groups import Sample
from sixthsense.evaluation.measure import relative_errors
from sixthsense.evaluation.measured_run import MeasuredRun


def sample_of(name: str, run: MeasuredRun) -> Sample:
    """The run under a name. The relative pose errors of one of an earlier version are measured from its record."""

    def measure() -> dict[str, Any]:
        known = dict(run.metrics)
        return known | (relative_errors(run.trace) if run.trace.truths and "rpe_trans_m_1m" not in known else {})

    return Sample(name, run.trace.config, measure, lambda: curves(run.trace))
