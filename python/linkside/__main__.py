"""``python -m linkside``."""

from linkside.cli import main

main()
