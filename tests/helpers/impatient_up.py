"""`pretouch up` on free ports, with health checks that follow each other at once: a test need not wait long."""

import asyncio
import sys
from pathlib import Path

from pretouch.serving import Settings
from pretouch.serving.probing import Probing
from pretouch.serving.up import Stack, up

if __name__ == "__main__":
    impatient = Probing(every=0.05, timeout=5.0, misses=2)
    stack = Stack(Settings(log_level="warning"), 0, 0, Path(sys.argv[1]), probing=impatient)
    asyncio.run(up(stack, lambda line: print(line, flush=True)))
