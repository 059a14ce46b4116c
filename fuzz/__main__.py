"""Fuzzes the wire formats: `python -m fuzz [--seconds 60] [--seed 0]`. It ends with 1 if an input breaks an invariant.

Such an input is left in the working directory; `python -m fuzz.target FILE` runs it again.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from fuzz.seeds import seeds

_LONGEST = 9_500
"""Bytes of an input: more than the automatic detection keeps."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=60, help="how long to fuzz")
    parser.add_argument("--seed", type=int, default=0, help="the fuzzer takes 0 as 1")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as corpus:
        for number, data in enumerate(seeds()):
            (Path(corpus) / f"seed-{number}").write_bytes(data)
        flags = [f"-max_total_time={arguments.seconds}", f"-seed={arguments.seed or 1}", f"-max_len={_LONGEST}"]
        command = [sys.executable, "-m", "fuzz.target", corpus, *flags, "-timeout=10", "-print_final_stats=1"]
        run = subprocess.run(command, stderr=subprocess.PIPE, text=True, errors="replace", check=False)
    executed = re.search(r"number_of_executed_units: *(\d+)", run.stderr)
    covered = re.findall(r"cov: (\d+) ft: (\d+)", run.stderr)
    if executed is None or not covered or run.returncode:
        print(run.stderr[-4000:], file=sys.stderr)
    if executed is not None and covered:
        edges, features = covered[-1]
        print(f"{executed[1]} inputs, {edges} edges and {features} features covered, ", end="")
        print("an invariant is broken" if run.returncode else "all invariants hold")
    return 1 if run.returncode else 0


if __name__ == "__main__":
    sys.exit(main())
