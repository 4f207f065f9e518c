"""Links between poses: the laws, for all shipped smoothers."""

import dataclasses

import pytest
from laws.links import LAWS

from sixthsense.slam.estimators import ESTIMATORS, Filter, Smoother, register_estimator
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.testing.estimation import CONVERGED, make

SMOOTHERS = [name for name in ESTIMATORS if isinstance(make(name), Smoother)]


def test_of_the_shipped_estimators_all_are_filters_and_one_is_a_smoother():
    assert all(isinstance(make(name), Filter) for name in ESTIMATORS)
    assert SMOOTHERS == ["isam2"]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", SMOOTHERS)
def test_links_keep_the_laws(name, law):
    law.check(name)


class Forgetful(ISAM2):
    """Keeps the links that it should remove."""

    def __init__(self, start, start_cov):
        super().__init__(start, start_cov, CONVERGED)

    def unlink(self, ids):
        for i in ids:
            del self._links[i]


class Overconfident(ISAM2):
    """Takes links as twice as certain as they are."""

    def __init__(self, start, start_cov):
        super().__init__(start, start_cov, CONVERGED)

    def link(self, links):
        sure = [
            dataclasses.replace(k, relative=dataclasses.replace(k.relative, cov=0.25 * k.relative.cov)) for k in links
        ]
        return super().link(sure)


@pytest.mark.parametrize(
    ("cls", "broken"),
    [(Forgetful, "removed_links_leave_no_trace"), (Overconfident, "links_give_the_least_squares_solution")],
)
def test_links_that_stay_and_links_of_another_weight_are_found(cls, broken):
    register_estimator("sabotaged-links", cls)
    law = next(law for law in LAWS if law.name == broken)
    with pytest.raises(AssertionError):
        law.check("sabotaged-links")
