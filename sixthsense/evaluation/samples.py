"""A finished run as one of several that are compared."""

from __future__ import annotations

from sixthsense.evaluation.curves import curves
from sixthsense.evaluation.groups import Sample
from sixthsense.evaluation.measure import relative_errors
from sixthsense.evaluation.measured_run import MeasuredRun


def sample_of(name: str, run: MeasuredRun) -> Sample:
    """The run under a name. The relative pose errors of one of an earlier version are measured from its record."""
    known = dict(run.metrics)
    if run.trace.truths and "rpe_trans_m_1m" not in known:
        known |= relative_errors(run.trace)
    return Sample(name, run.trace.config, known, lambda: curves(run.trace))
