"""The experiments of the four papers: each is run and drawn, and its numbers are compared with the published ones.

Each paper has a module with a function ``reproduce``, which returns a `reproduction.Reproduction`; `names.PAPERS` lists
the modules. ``linkside paper`` runs them from the command line.
"""
