"""Sixth Sense: a workbench for 2-D laser SLAM."""

__version__ = "0.1.0"
