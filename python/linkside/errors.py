"""Exceptions and warnings of linkside; each error is also the built-in error that a caller would expect."""

LONGEST = 500
"""Characters of a message."""


class LinksideError(Exception):
    """Base of every error that linkside raises on purpose. Its message is one line: what is wrong, and where."""

    def __str__(self) -> str:
        """One printable line of at most 500 characters."""
        return printable(super().__str__())


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


class LinksideWarning(UserWarning):
    """Base of linkside's warnings: an estimate is possible, but may be wrong for the reason given."""


class RecordingWarning(LinksideWarning):
    """Something in a recording is suspicious, or was corrected: names the column, the row and the remedy."""


class RobotWarning(LinksideWarning):
    """Something in a description of a robot is suspicious, or is not used."""


def printable(message: str) -> str:
    """Fold a message into one printable line, the middle left out if it is long."""
    line = " ".join(message.split())
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in line)
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 103]} … {line[-100:]}"
