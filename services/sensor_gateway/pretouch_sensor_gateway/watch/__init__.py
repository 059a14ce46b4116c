"""The view of `pretouch gateway watch`: live ranges, rates, losses and clock of a gateway's devices, in a terminal.

feed.py       a gateway over gRPC ──▶ state.py: what is known of each device; events.py: what happened
view.py       state ──▶ a screen; log_lines.py: state ──▶ lines for a log
terminal.py   keeps the screen up to date and reads the keys
"""
