"""What every room speaks: poses, motion, scans, landmarks, the seam of a source of evidence."""
