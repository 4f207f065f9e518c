"""Links between poses: the laws, for all shipped estimators that keep their poses."""

import dataclasses

import pytest

from sixthsense.slam.estimators import ESTIMATORS, keeps_poses
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.testing import check_estimator
from sixthsense.testing.check import LAWS, LINK_LAWS, PRIOR_MAP_LAWS, WHEEL_LAWS
from sixthsense.testing.estimation import CONVERGED, make

KEEPING = [name for name in ESTIMATORS if keeps_poses(make(name))]


def test_the_smoother_alone_keeps_poses():
    assert KEEPING == ["isam2"]


@pytest.mark.parametrize("law", LINK_LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("name", KEEPING)
def test_links_keep_the_laws(name, law):
    law.check(name)


class Forgetful(ISAM2):
    """Keeps the links that it should remove."""

    def __init__(self, start, start_cov):
        super().__init__(start, start_cov, CONVERGED)

    def unlink(self, ids):
        self._links.drop(ids)


class Overconfident(ISAM2):
    """Takes links as twice as certain as they are."""

    def __init__(self, start, start_cov):
        super().__init__(start, start_cov, CONVERGED)

    def link(self, links):
        sure = [
            dataclasses.replace(k, relative=dataclasses.replace(k.relative, cov=0.25 * k.relative.cov)) for k in links
        ]
        return super().link(sure)


@pytest.mark.slow
def test_an_estimator_that_keeps_removed_links_is_found():
    verdicts = check_estimator(Forgetful, "forgetful")
    assert (
        len(verdicts) == len(LAWS) + len(LINK_LAWS) + len(WHEEL_LAWS) + len(PRIOR_MAP_LAWS)
        and verdicts["removed_links_leave_no_trace"]
    )


def test_links_of_another_weight_are_found():
    from sixthsense.slam.estimators import register_estimator

    register_estimator("overconfident", Overconfident)
    law = next(law for law in LINK_LAWS if law.name == "links_give_the_least_squares_solution")
    with pytest.raises(AssertionError):
        law.check("overconfident")
