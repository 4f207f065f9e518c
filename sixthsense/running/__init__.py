"""One run with its folder, bag, progress bar and view."""
