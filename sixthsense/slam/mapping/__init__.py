"""The grid of obstacles and seen area, and its free space."""
