"""Simulated fingertips: what a time-of-flight module reports in a world, from the ideal beam to an unknown cone.

`finger.FingerModel` lists them by their modules' names.
"""
