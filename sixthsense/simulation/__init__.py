"""The simulated world, with its scenes and the people in them."""
