"""What several test files share: fakes, probes and builders of input."""
