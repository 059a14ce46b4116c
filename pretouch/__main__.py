"""`python -m pretouch`: the command line."""

from pretouch.cli import main

main()
