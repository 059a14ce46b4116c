"""Coverage-guided fuzzing of the sensor gateway's wire formats: `python -m fuzz --seconds 60 --seed 0`.

The invariants are in `harness`; the test suite runs them over mutated seeds without the fuzzer.
"""
