"""Labels from simulated scans: the finger scans the displaced mesh, and an engine registers the scan."""
