"""What a run is worth, by the truth: errors, consistency, coverage, calibration."""
