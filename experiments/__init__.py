"""The measurements behind `docs/results`, a command each: `python -m experiments.table1`."""
