"""Types shared by all rooms: poses, motion, scans, landmarks, and the interface of a source."""
