"""From odometry and scans to an estimate and a map: features, association, estimators, mapping."""
