"""The dense front end: scans are aligned with earlier scans, and their relative poses are links of a pose graph."""
