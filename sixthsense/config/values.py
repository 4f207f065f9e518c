"""Types of values that fields of the configuration share."""

from __future__ import annotations

from typing import Annotated, Literal

from sixthsense.config.section import Range

Positive = Annotated[float, Range(0.0, open_low=True)]
NonNegative = Annotated[float, Range(0.0)]
Noise = Annotated[float, Range(0.0, 100.0)]
AngularNoise = Annotated[float, Range(0.0, 100.0, unit="rad")]
Probability = Annotated[float, Range(0.0, 1.0 - 1e-12, open_low=True)]
PositiveCount = Annotated[int, Range(1)]
Count = Annotated[int, Range(0)]
Distribution = Literal["gaussian", "uniform"]
