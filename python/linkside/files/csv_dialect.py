"""How a CSV file is written: separator, decimal mark, encoding, lines before the header, names of columns."""

from __future__ import annotations

import codecs
import csv
import gzip
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

SAMPLE = 65_536
"""Bytes of a file that are looked at."""

SEPARATORS = (",", ";", "\t", "|")
COMMENTS = ("#", "%", "//")
DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*")
NUMBER = re.compile(r"\s*[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?\s*|\s*nan\s*|\s*", re.IGNORECASE)


@dataclass(frozen=True)
class Dialect:
    """How a CSV file is written.

    Attributes
    ----------
    separator : str
        Between columns.
    decimal : str
        Decimal mark, a point or a comma.
    encoding : str
        As Python calls it.
    skipped : int
        Lines before the first sample.
    names : tuple of str
        The columns, blanks around them left out.
    """

    separator: str
    decimal: str
    encoding: str
    skipped: int
    names: tuple[str, ...]

    @classmethod
    def of(cls, path: str | Path) -> Dialect:
        """Recognise a file's; ValueError says what is expected where that cannot be."""
        opener = gzip.open if str(path).lower().endswith(".gz") else open
        with opener(path, "rb") as file:
            raw = file.read(SAMPLE)
        encoding = _encoding(raw)
        text = codecs.getincrementaldecoder(encoding)(errors="strict").decode(raw)
        lines = re.split(r"\r\n|\n|\r", text)
        if len(raw) == SAMPLE and len(lines) > 1:
            del lines[-1]  # cut off in its middle
        return cls._of_lines(lines, encoding)

    @classmethod
    def _of_lines(cls, lines: Sequence[str], encoding: str) -> Dialect:
        stated = re.fullmatch(r"sep=(.)", lines[0].strip()) if lines else None  # as Excel writes it
        first, header = 1 if stated else 0, ""
        while first < len(lines) and (not lines[first].strip() or lines[first].lstrip().startswith(COMMENTS)):
            header, first = lines[first].lstrip("#%/ ") or header, first + 1
        if first == len(lines):
            raise ValueError("no header: a line with the names of the columns is expected")
        separator = stated[1] if stated else _separator(lines[first])
        cells = _cells(lines[first], separator)
        if all(map(NUMBER.fullmatch, cells)) and len(_cells(header, separator)) == len(cells):
            skipped, names = first, _cells(header, separator)  # the header is a comment, as NumPy writes it
        else:
            skipped, names = first + 1, cells
        samples = (cell for line in lines[skipped : skipped + 50] for cell in _cells(line, separator))
        decimal = "," if separator != "," and any(map(DECIMAL_COMMA.fullmatch, samples)) else "."
        return cls(separator, decimal, encoding, skipped, tuple(name.strip() for name in names))


def _encoding(raw: bytes) -> str:
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if raw.count(0) > len(raw) // 4:
        raise ValueError("this looks like UTF-16 without a byte order mark: text in UTF-8 is expected")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(raw)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig" if raw.startswith(codecs.BOM_UTF8) else "utf-8"


def _separator(header: str) -> str:
    """The one that makes the most columns."""
    best = max(SEPARATORS, key=lambda separator: len(_cells(header, separator)))
    if len(_cells(header, best)) == 1 and len(header.split()) > 1:
        raise ValueError("columns separated by blanks: a comma, a semicolon or a tab is expected between them")
    return best


def _cells(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
