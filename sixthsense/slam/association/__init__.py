"""Data association: which observation is of which landmark."""
