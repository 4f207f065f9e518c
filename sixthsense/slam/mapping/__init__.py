"""The grid of obstacles and seen area, and the free space of it."""
