"""The asynchronous clients. `synchronous` is generated from this package by `make client`."""
