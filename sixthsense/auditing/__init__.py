"""An audit of covariances: poses of any system against the truth."""
