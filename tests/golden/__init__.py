"""Golden runs: six small runs over fixed drives, and each figure that they write."""
