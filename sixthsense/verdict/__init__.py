"""Whether a map is right, told without truth: evidence, a calibrated probability, a cause."""
