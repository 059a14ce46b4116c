"""The dashboard: HTML, CSS and modules of JavaScript, served by `rest/dashboard.py`."""
