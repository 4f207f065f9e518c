"""The live view: a run as it goes, in Rerun's window, in a browser or in a file; the only package that knows Rerun."""
