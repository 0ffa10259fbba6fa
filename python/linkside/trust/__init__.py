"""Whether to trust an estimate: contradictions between readings and model, and parameters known to a tolerance only."""

from .findings import Finding

__all__ = ["Finding"]
