"""Check that a path is a regular file: reading a pipe or a device could block or never end."""

import os
import stat
from pathlib import Path

KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def instead(path: str | Path) -> str:
    """Say what is there instead of a file; '' for a file. Raises OSError where nothing is."""
    mode = os.stat(path).st_mode
    return "" if stat.S_ISREG(mode) else KINDS.get(stat.S_IFMT(mode), "no file")
