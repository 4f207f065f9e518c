"""Independent streams of random numbers, one for each stage that draws, all from the seed of a run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class RandomStreams(NamedTuple):
    """A generator per stage, so that another planner leaves the noise of the world alone."""

    world: np.random.Generator
    planner: np.random.Generator
    exploration: np.random.Generator
    walkers: np.random.Generator


def random_streams(seed: int) -> RandomStreams:
    """Spawn the streams of a run from its seed."""
    return RandomStreams(*(np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4)))
