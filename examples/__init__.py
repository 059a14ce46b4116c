"""Robot programs to copy from."""
