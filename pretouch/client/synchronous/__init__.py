# Generated from pretouch/client/asynchronous by `make client`: change that.
"""The synchronous clients, generated from `asynchronous`."""
