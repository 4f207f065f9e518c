"""Where evidence comes from: the simulated world and its scenes, and logs of robots."""
