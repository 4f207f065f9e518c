"""Laws of optional capabilities of estimators, and drives of the whole pipeline with known statistics."""
