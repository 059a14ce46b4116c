"""The engines: from what the camera saw and what the finger measured to a corrected pose. Pure computation, no I/O."""
