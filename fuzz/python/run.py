"""Fuzz a target with atheris, which follows the branches of linkside's Python: ``run.py TARGET [OPTIONS]``."""

import sys

import atheris

with atheris.instrument_imports(include=["linkside"]):
    import targets

if __name__ == "__main__":
    atheris.Setup([sys.argv[0], *sys.argv[2:]], targets.TARGETS[sys.argv[1]])
    atheris.Fuzz()
