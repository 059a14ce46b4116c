"""Parsers for the wire formats that the gateway understands, and what they have in common."""
