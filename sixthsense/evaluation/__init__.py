"""Evaluation of runs against the truth: errors, consistency, coverage, matches, and calibration of noise."""
