"""Fuzzing of the services' two APIs, on a real `pretouch up`: `python -m fuzz.apis --seconds 600 --seed 0`.

REST gets what schemathesis makes of its OpenAPI document, gRPC what `messages` makes of good requests to all four
services. Whatever comes, no answer is 500 or INTERNAL, no process ends or grows beyond its bound, and nothing in the
log is a defect.
"""
