"""Parameters that are estimated beside the map, those of wheels or of a sensor, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from sixthsense.core.geometry import Array


class Values(Protocol):
    """Parameters by name."""

    def array(self) -> Array:
        """(p,) in the order of the fields."""
        ...


P = TypeVar("P", bound=Values)


@dataclass(frozen=True, slots=True)
class ParameterEstimate(Generic[P]):
    """Parameters with their uncertainty: a prior, or an estimate."""

    values: P
    cov: Array
    """(p, p) of the parameters, in the order of the fields"""

    def with_sigmas(self) -> Array:
        """(2, p) the parameters, and their sigmas."""
        return np.stack([self.values.array(), np.sqrt(np.maximum(np.diag(self.cov), 0.0))])
