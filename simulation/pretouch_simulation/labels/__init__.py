"""Labels from what really happens: the finger scans the displaced mesh, and an engine answers."""
