"""`python -m flexspline`: the command line."""

from .commands import main

main()
