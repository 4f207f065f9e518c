"""How far a landmark is off where it is seen anew: from another side, or at another stretch.

A wall may bend between two stretches that are never seen together, and the face of a thin wall has a corner beside that
of the other face. One scan shows neither. Both make innovations larger where a landmark is seen anew than the estimator
expects, so their size is the excess of the squared innovations there, over all landmarks of a building.
"""

from __future__ import annotations

from sixthsense.core.covariance import mean_square_limit
from sixthsense.slam.association.corners import MEMORY

_LARGEST = 9.0
"""of a mean squared innovation: a wrong match says nothing of others"""


class Displacement:
    """Measures the error that stays while a landmark is seen alike, and is drawn anew where it is seen anew."""

    def __init__(self) -> None:
        self._count = 0.0
        self._squares = 0.0
        self._information = 0.0

    def add(self, squared: float, information: float, weight: float = 1.0) -> None:
        """Take a landmark that is seen anew, by the probability that it is this one.

        `squared` is its squared innovation, of two degrees of freedom, and `information` how much the mean of that
        grows with the displacement, 1/m^2.
        """
        keep = 1.0 - 1.0 / MEMORY
        self._count = keep * self._count + weight
        self._squares = keep * self._squares + weight * min(0.5 * squared, _LARGEST)
        self._information = keep * self._information + weight * information

    @property
    def square_m2(self) -> float:
        """The mean square of the error of a sight that another one does not share, which is half of their difference's.

        It is 0 where the innovations are no larger than chance makes them.
        """
        if self._count < 1.0:
            return 0.0
        excess = self._squares / self._count - mean_square_limit(2.0 * self._count)
        return 0.5 * max(0.0, excess) * self._count / self._information
