"""`python -m mckibben`: the command line."""

from mckibben.cli import run

run()
