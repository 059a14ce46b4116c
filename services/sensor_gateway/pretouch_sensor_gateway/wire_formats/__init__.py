"""The wire formats that the gateway understands, a file each."""
