"""The fleet of DESIGN's section 6, as processes on loopback or in containers, with parts that can be broken."""
