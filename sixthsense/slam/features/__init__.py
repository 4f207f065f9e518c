"""From a scan to walls and landmarks, and the de-skewing before it."""

from sixthsense.slam.features.extraction import NO_FEATURES, Features, extract

__all__ = ["NO_FEATURES", "Features", "extract"]
