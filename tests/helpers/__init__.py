"""What several test files share: fakes, probes, builders of input. Nothing here is a test."""
