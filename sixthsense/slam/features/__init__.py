"""From a scan to walls and landmarks, and the de-skewing before it."""

from sixthsense.slam.features.extraction import Features, extract

__all__ = ["Features", "extract"]
