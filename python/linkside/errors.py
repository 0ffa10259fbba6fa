"""What linkside raises: one family, each member also the built-in error a caller would expect."""


class LinksideError(Exception):
    """Base of every error that linkside raises on purpose. Its message is one line: what is wrong, and where."""


class ConfigError(LinksideError, ValueError):
    """A robot.yaml or a URDF that cannot be used: names the file, the line, the key and what was expected."""


class LogError(LinksideError, ValueError):
    """A recording that cannot be used: names the file, the column and the row."""


class EstimatorError(LinksideError, ValueError):
    """Settings of an estimator, or an argument's shape, that cannot be used."""


class NumericalError(LinksideError, ArithmeticError):
    """A computation that broke down: names the sample at which it did."""


class OutputError(LinksideError, OSError):
    """A file that cannot be written."""
