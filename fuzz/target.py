"""What the fuzzer runs, as a process of its own, because the fuzzer ends it: `python -m fuzz.target CORPUS FLAGS`."""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["pretouch_sensor_gateway.wire_formats"]):
    from fuzz.harness import check_input

if __name__ == "__main__":
    atheris.Setup(sys.argv, check_input)
    atheris.Fuzz()
