"""``python -m linkside.cli``."""

from . import main

main()
