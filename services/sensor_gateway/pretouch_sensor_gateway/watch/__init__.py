"""The view of `pretouch gateway watch`: live ranges, rates, losses and clock of a gateway's devices, in a terminal.

feed.py          a gateway over gRPC ──▶ state.py
state.py         what is known of each device; events.py: its recent events; trace.py: its recent ranges
view.py          state ──▶ a screen; module_table.py, gauges.py, status_facts.py: its parts; status_codes.py: its words
log_lines.py     state ──▶ lines for a log
terminal.py      keeps the screen up to date and reads the keyboard; keys.py: the keys
"""
