"""From the map to a command: what to look at next, paths, driving, and the guard that stops the robot."""
