"""`pretouch gateway watch`: live ranges, rates, drops and clock of a gateway's devices, in a terminal.

feed.py          a gateway over gRPC ──▶ state.py
state.py         what is known of each device; events.py: what happened; trace.py: its ranges of late
view.py          state ──▶ a screen; modules.py, gauges.py, facts.py: its parts; status_codes.py: its words
lines.py         state ──▶ lines for a log
terminal.py      the screen kept up to date, and the keys; keys.py: what they mean
"""
