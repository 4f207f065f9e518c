"""Sources of odometry and scans: the simulated world with its scenes, and recorded logs."""
