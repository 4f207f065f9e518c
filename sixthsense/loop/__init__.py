"""The loop: a source, `Slam`, a pilot and watchers, one control tick at a time."""
