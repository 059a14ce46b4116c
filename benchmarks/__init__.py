"""Speed and memory, always beside a peer, as a ratio in one run."""
