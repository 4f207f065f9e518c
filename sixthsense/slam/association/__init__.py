"""Which sighting is of which landmark."""
