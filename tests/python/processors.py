"""The same program on several processors: what it prints must not depend on their instructions."""

import os
import subprocess
import sys

BOTH = ({"LINKSIDE_SIMD": "baseline"}, {"LINKSIDE_SIMD": "widest"})


def outputs(program, environments=BOTH, **options):
    """All that a Python program prints, run once in each of the environments; further options as of `subprocess`."""
    command = [sys.executable, "-c", program]
    return {subprocess.check_output(command, env=os.environ | more, text=True, **options) for more in environments}
