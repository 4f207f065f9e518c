"""Data association: which sighting is of which landmark."""
