"""Chaos on a fleet: any one part breaks every few seconds while robots work, and nothing that was answered is lost."""
