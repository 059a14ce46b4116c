"""Speed and memory, beside a peer, as a ratio in one run; and the gateway in simulated hours of faults and of clocks."""
