"""Shows the newest session of an orchestrator, as it grows, in Foxglove and Rerun.

It repeats the messages of the session's recording, and needs nothing but the public REST API.
"""
