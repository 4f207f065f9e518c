"""The live view of a run in a Rerun window, a browser or a file; the only package that imports Rerun."""
