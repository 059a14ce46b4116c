"""What recordings in MCAP files have in common: those of fingers and those of sessions. Needs the package `mcap`."""
