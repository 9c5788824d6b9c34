"""Read YAML as plain content (mappings, lists, text, numbers, truth values) within bounds of size, depth and aliases.

YAML allows much that a configuration must not have. This reader refuses tags, repeated keys, numbers that are not
finite, aliases that multiply, and content that contains itself. Plain words mean what YAML 1.2 says: `1:30` and
`2026-02-30` are text, only `true` and `false` are truth values, and `1e5` is a number.
"""

import math
import re
from pathlib import Path
from typing import Any, ClassVar

import yaml

from gri.errors import InputError

LARGEST = 2**20  # bytes of a file
DEEPEST = 40  # levels of nesting
MOST = 20_000  # values of a file; what an alias repeats counts again
LONGEST = 18  # characters of an integer, which then fits into 64 bits
KEYS = ("tag:yaml.org,2002:str", "tag:yaml.org,2002:int", "tag:yaml.org,2002:merge")
NUMBER = r"[-+]?(?:\.[0-9]+|(?:0|[1-9][0-9]*)(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
UNBOUNDED = r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff]")  # not in names or texts; surrogates are half characters


def read_content(path: Path) -> tuple[Any, yaml.Node | None]:
    """The content of a YAML file and its tree of nodes, which knows lines.

    Raises `InputError` with file and line if the file cannot be read, is not valid YAML, or breaks a bound.
    """
    return content_of(_text(path), path)


def content_of(text: str, source: Path | str) -> tuple[Any, yaml.Node | None]:
    """The content of a YAML text and its tree of nodes. Raises `InputError`, which names `source` and the line."""
    loader = None
    try:
        loader = _Loader(text)
        tree = loader.get_single_node()
        return (None if tree is None else loader.construct_document(tree)), tree
    except _Refusal as error:
        raise InputError(f"{source}:{error.line}: {error}") from None
    except Exception as error:  # of the many that PyYAML raises for the many ways in which a file can be wrong
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        reason = " ".join(str(getattr(error, "problem", None) or error).split())[:200]
        raise InputError(f"{source}{where}: not valid YAML ({reason}); correct it") from None


def _text(path: Path) -> str:
    """The text of a file. Raises `InputError` if there is none, or too much."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: cannot be read (not a file); give the path of a YAML file")
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise InputError(
                f"{path}: more than {LARGEST // 2**20} MiB of YAML; split it, or check that it is the file"
            )
        return content.decode("utf-8")
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise InputError(f"{path}: cannot be read ({reason}); give the path of a YAML file") from error


class _Refusal(Exception):
    """Valid YAML that a configuration must not have."""

    def __init__(self, node: yaml.Node | yaml.Event, problem: str) -> None:
        super().__init__(problem)
        self.line = node.start_mark.line + 1


class _Loader(yaml.SafeLoader):
    """PyYAML's loader with the plain words of YAML 1.2, which checks every node while it reads it."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}  # filled below

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._level = self._count = 0
        self._sizes: dict[int, tuple[int, int]] = {}  # of a finished node: values in it, and levels below it

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        """The next node, checked. It is complete here, and so are its children."""
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            node = super().compose_node(parent, index)
            if node is not None and id(node) not in self._sizes:
                raise _Refusal(event, "an alias refers to content that contains it; write the values out")
            return node
        if getattr(event, "tag", None) not in (None, "!"):
            raise _Refusal(
                event,
                f"got the tag {_short(event.tag.replace('tag:yaml.org,2002:', '!!'))}; write the value without a tag",
            )
        self._level += 1
        self._count += 1
        if self._level > DEEPEST:
            raise _Refusal(event, f"more than {DEEPEST} levels of nesting; write it flatter")
        if self._count > MOST:
            raise _Refusal(event, f"more than {MOST} values; give fewer")
        node = super().compose_node(parent, index)
        self._level -= 1
        if node is not None:
            self._check(node)
        return node

    def _check(self, node: yaml.Node) -> None:
        children: list[yaml.Node] = []
        if isinstance(node, yaml.ScalarNode):
            _check_scalar(node)
        elif isinstance(node, yaml.MappingNode):
            _check_keys(node)
            children = [child for pair in node.value for child in pair]
        elif isinstance(node, yaml.SequenceNode):
            children = node.value
        sizes = [self._sizes[id(child)] for child in children]
        size, depth = 1 + sum(size for size, _ in sizes), 1 + max((depth for _, depth in sizes), default=0)
        if size > MOST:
            raise _Refusal(node, f"more than {MOST} values, those repeated by aliases included; give fewer")
        if depth > DEEPEST:
            raise _Refusal(node, f"more than {DEEPEST} levels of nesting, aliases included; write it flatter")
        self._sizes[id(node)] = size, depth


def _check_scalar(node: yaml.ScalarNode) -> None:
    kind = node.tag.rpartition(":")[2]
    if kind == "float" and (node.value[-1] in "fFnN" or not math.isfinite(float(node.value))):  # ".inf", "1e999"
        raise _Refusal(node, f"got {_short(node.value)}, expected a finite number")
    if kind == "int" and len(node.value) > LONGEST:
        raise _Refusal(node, f"got {_short(node.value)}, a number of {len(node.value)} digits; give a smaller one")
    if CONTROL.search(node.value):
        raise _Refusal(node, f"got {_short(node.value)}, text with a control character; remove it")


def _check_keys(node: yaml.MappingNode) -> None:
    """Keys must be names or integers, each once: loaders silently keep the last of two."""
    seen = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode) or key.tag not in KEYS:
            shown = _short(key.value) if isinstance(key, yaml.ScalarNode) else "a list or mapping"
            raise _Refusal(key, f"got the field name {shown}, expected a word or an integer")
        same = int(key.value) if key.tag.endswith(":int") else key.value
        if same in seen:
            raise _Refusal(key, f"field {_short(key.value)} is given twice; keep one")
        seen.add(same)


def _short(text: str) -> str:
    """At most 60 printable characters."""
    shown = text if text.isprintable() else repr(text)
    return shown if len(shown) <= 60 else f"{shown[:40]}… ({len(text)} characters)"


for _kind, _pattern, _first in (
    ("bool", "true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", "~|null|Null|NULL|", "~nN\0"),
    ("int", "[-+]?(?:0|[1-9][0-9]*)", "-+0123456789"),
    ("float", f"{NUMBER}|{UNBOUNDED}", "-+.0123456789"),
    ("merge", "<<", "<"),
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_kind}", re.compile(rf"^(?:{_pattern})$"), [c.strip("\0") for c in _first]
    )
_Loader.add_constructor("tag:yaml.org,2002:int", lambda loader, node: int(node.value))
_Loader.add_constructor("tag:yaml.org,2002:float", lambda loader, node: float(node.value))
