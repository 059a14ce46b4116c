"""Speed and memory beside a peer, as a ratio in one run; the gateway in hours of simulated faults and clocks."""
