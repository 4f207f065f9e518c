"""A run's data: in memory, in its folder, in its bag."""
