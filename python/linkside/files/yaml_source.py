"""The source of settings: a YAML file with line numbers, or Python values without.

Pydantic says what is wrong with a value; a `Source` says where it stands, in one line a user can act on.
"""

import difflib
import reprlib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLWarning

from linkside.errors import ConfigError
from linkside.files.writing import write_text

from .regular import instead

LARGEST = 64 * 2**20
"""Bytes of a file of settings, or of a URDF."""

DEEPEST = 32
"""How deep settings nest."""

MOST = 200_000
"""Values in settings."""

Model = TypeVar("Model", bound=BaseModel)
Key = str | int

# What was expected, by pydantic's error type; `refusal` covers the rules that are ours.
EXPECTED = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "string_type": "text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "literal_error": "one of {expected}",
    "tuple_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "invalid_key": "a key that is text",
}


def refusal(message: str, *at: Key) -> PydanticCustomError:
    """Build the error that a validator raises for a rule of ours; `at` leads on to the key to blame."""
    return PydanticCustomError("refused", "{message}", {"message": message, "at": list(at)})


def suggest(name: str, known: Iterable[str]) -> str:
    """Say which of the known names was probably meant, or which there are."""
    names = list(known)
    if close := difflib.get_close_matches(name, names, n=1):
        return f"did you mean '{close[0]}'?"
    return f"there is {', '.join(names[:12])}{', …' if len(names) > 12 else ''}" if names else "there is none"


@dataclass(frozen=True)
class Source:
    """A tree of settings and where it was read.

    Attributes
    ----------
    tree
        The settings; as read from a file, a tree that ruamel.yaml writes back with its comments and order.
    name : str or None
        The file as messages call it; None for values given in Python.
    """

    tree: Any
    name: str | None = None

    @classmethod
    def read(cls, path: str | PathLike[str]) -> "Source":
        """Read a YAML file; raises ConfigError if that cannot be done or if it is no mapping."""
        name = fspath(path)
        tree = _parse(read_text(name), name)
        if not isinstance(tree, Mapping):
            raise ConfigError(f"{name}: expected a mapping, got {_got(tree)}")
        if fault := _endless(tree):
            raise ConfigError(f"{name}: {fault}")
        return cls(tree, name)

    def where(self, *keys: Key) -> str:
        """Name a key's file, line and path, as far as known: `robot.yaml:12: joints[0].name: `."""
        place = f"{self.name}:{self._line(keys)}: " if self.name is not None else ""
        path = "".join(f"[{key}]" if isinstance(key, int) else f".{_printable(key)}" for key in keys)
        path = path.removeprefix(".")
        return place + (f"{path}: " if path else "")

    def validate(self, model: type[Model]) -> Model:
        """Check the tree against a pydantic model; raises ConfigError about the first thing that is wrong."""
        try:
            return model.model_validate(self.tree)
        except ValidationError as error:
            first, *others = sorted(error.errors(include_url=False), key=lambda e: self._line(e["loc"]))
            more = f" (and {len(others)} more)" if others else ""
            raise ConfigError(self._explain(first, model) + more) from None

    def _explain(self, error: ErrorDetails, model: type[BaseModel]) -> str:
        keys, kind, context = error["loc"], error["type"], error.get("ctx", {})
        if kind == "missing":
            return f"{self.where(*keys[:-1])}missing key '{keys[-1]}'"
        if kind == "extra_forbidden":  # of files with one level of keys; robot.yaml's sections refuse their own
            return f"{self.where(*keys)}unknown key; {suggest(str(keys[-1]), model.model_fields)}"
        if kind == "refused":
            return f"{self.where(*keys, *context['at'])}{context['message']}"
        expected = EXPECTED[kind].format(**context) if kind in EXPECTED else error["msg"]
        return f"{self.where(*keys)}expected {expected}, got {_got(error['input'])}"

    def _line(self, keys: Sequence[Key]) -> int:
        """Line of the last key that has one, counted from 1: a merged (`<<`) or a missing key has none."""
        node, line = self.tree, 0
        for key in keys:
            try:
                line = node.lc.item(key)[0] if isinstance(key, int) else node.lc.key(key)[0]
                node = node[key]
            except (AttributeError, LookupError, TypeError):
                break
        return int(line) + 1


def read_text(name: str) -> str:
    """Read a file of text; raises ConfigError if that cannot be done."""
    try:
        if other := instead(name):
            raise ConfigError(f"{name}: this is {other}, a file is expected")
        if (size := Path(name).stat().st_size) > LARGEST:
            raise ConfigError(f"{name}: a file of at most {LARGEST} bytes is expected, not of {size}")
        return Path(name).read_text(encoding="utf-8")
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{name}: {(error.strerror or str(error)).lower()}") from None
    except ValueError:  # a UnicodeDecodeError, or a path with a null byte
        raise ConfigError(f"{name}: expected text in UTF-8") from None


def _parse(text: str, name: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", YAMLWarning)  # a style that YAML 1.1 would read differently
        try:
            return YAML(typ="rt").load(text)
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            line = f":{mark.line + 1}" if mark else ""
            raise ConfigError(f"{name}{line}: not valid YAML: {one_line(error.problem or error)}") from None
        except (
            Exception
        ) as error:  # not only YAMLError: ruamel.yaml lets ValueError, KeyError, … of odd scalars through
            raise ConfigError(f"{name}: not valid YAML: {one_line(error)}") from None


def _endless(tree: Any) -> str:
    """Say that settings nest or repeat beyond all use, as aliases of aliases do; '' if not."""
    level, count = [tree], 0
    for _ in range(DEEPEST):
        level = [v for node in level if isinstance(node, Mapping | list) for v in _values(node)]
        count += len(level)
        if count > MOST:
            return f"expected at most {MOST} values"
        if not level:
            return ""
    return f"expected settings at most {DEEPEST} deep"


def _values(node: Any) -> list[Any]:
    return list(node.values()) if isinstance(node, Mapping) else list(node)


def one_line(message: object) -> str:
    """Fold a message of several lines into one."""
    return " ".join(str(message).split())


def _printable(key: str) -> str:
    return key if key.isprintable() else repr(key)


def _got(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return str(value).lower() if isinstance(value, bool) else reprlib.repr(value)


def write_yaml(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write a settings file whole or not at all; `OutputError` when that cannot be."""
    text = StringIO()
    YAML().dump(values, text)
    write_text(path, text.getvalue())
