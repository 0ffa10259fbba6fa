"""The papers whose experiments can be repeated."""

PAPERS = {
    "deluca2007": "De Luca, Schröder, Thümmel 2007: an observer driven by accelerometers, and control on its estimate",
    "axelsson2012": "Axelsson, Karlsson, Norrlöf 2012: EKF and particle filter for the tool's position",
    "ulrich2011": "Ulrich, Sasiadek 2011: EKF and adaptive control of a space robot with elastic joints",
    "cristofaro2023": "Cristofaro, De Luca 2023: a reduced-order velocity observer",
}
"""Modules of this package, and what they repeat."""
