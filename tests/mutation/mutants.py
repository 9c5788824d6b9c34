"""Small wrong changes of a module's functions: one operator, number, word, index, argument or condition at a time."""

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass

SWAPPED: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Div,
    ast.Pow: ast.Mult, ast.Mod: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A changed module and where it was changed; `function` is the qualified name of the function around it."""

    module: str
    function: str
    line: int
    text: str
    source: str
    place: "Path"
    change: Callable[[ast.AST], ast.AST]

    @property
    def tree(self) -> ast.Module:
        """The changed module."""
        tree = ast.parse(self.source)
        _replace(tree, self.place, self.change)
        return ast.fix_missing_locations(tree)

    @property
    def name(self) -> str:
        """Module, function, source line and change: what stays when lines move."""
        return f"{self.module}: {self.function}: {self.source.splitlines()[self.line - 1].strip()}: {self.text}"

    def __str__(self) -> str:
        return f"{self.module}:{self.line} {self.function}: {self.text}"


def mutants(module: str, source: str) -> Iterator[Mutant]:
    """All mutants of a module's functions; docstrings, messages, decorators and annotations stay as they are."""
    tree = ast.parse(source)
    for function, path in _places(tree, (), ""):
        node = _at(tree, path)
        for before, change in _changes(node):
            shown = node if hasattr(node, "lineno") else _at(tree, path[:-1])  # an operator has no line of its own
            code = ast.unparse(shown).splitlines()[0][:60]
            text = f"{code}{'' if shown is node else f', {type(node).__name__}'} → {before}"
            yield Mutant(module, function, getattr(shown, "lineno", 0), text, source, path, change)


_LEFT_ALONE = ("decorator_list", "annotation", "returns", "type_params", "exc")
Path = tuple[tuple[str, int | None], ...]


def _places(node: ast.AST, path: Path, function: str, within: bool = False) -> Iterator[tuple[str, Path]]:
    """The function around each part of a tree, and its place; `within` a class alone there is none to change."""
    for name, value in ast.iter_fields(node):
        if name in _LEFT_ALONE or isinstance(node, ast.JoinedStr) or (name == "args" and _is_function(node)):
            continue
        for k, child in enumerate(value) if isinstance(value, list) else ((None, value),):
            if not isinstance(child, ast.AST) or _is_text(child):
                continue
            inside, place, deeper = function, (*path, (name, k)), within
            if isinstance(child, ast.FunctionDef | ast.ClassDef) and not within:
                inside, deeper = f"{function}.{child.name}".strip("."), isinstance(child, ast.FunctionDef)
            elif within:
                yield function, place
            yield from _places(child, place, inside, deeper)


def _is_function(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef | ast.Lambda)


def _is_text(node: ast.AST) -> bool:
    """A docstring, or another constant on a line of its own, such as `...`."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _at(tree: ast.AST, path: Path) -> ast.AST:
    for name, k in path:
        value = getattr(tree, name)
        tree = value if k is None else value[k]
    return tree


def _replace(tree: ast.AST, path: Path, change: Callable[[ast.AST], ast.AST]) -> None:
    parent, (name, k) = _at(tree, path[:-1]), path[-1]
    if k is None:
        setattr(parent, name, change(getattr(parent, name)))
    else:
        getattr(parent, name)[k] = change(getattr(parent, name)[k])


def _changes(node: ast.AST) -> Iterator[tuple[str, Callable[[ast.AST], ast.AST]]]:
    """What a node may become, in words and as a function."""
    if type(node) in SWAPPED:
        other = SWAPPED[type(node)]
        yield other.__name__, lambda _: other()
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield str(not node.value), lambda old: ast.Constant(not old.value)  # type: ignore[attr-defined]
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield f"{node.value} + 1", lambda old: ast.Constant(old.value + 1)  # type: ignore[attr-defined]
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        yield "without its sign", lambda old: old.operand  # type: ignore[attr-defined]
    elif isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice) and isinstance(node.ctx, ast.Load):
        yield "whole", lambda old: old.value  # type: ignore[attr-defined]
    elif isinstance(node, ast.If | ast.While | ast.IfExp):
        yield "never", lambda old: _with_test(old, False)
        yield "always", lambda old: _with_test(old, True)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _FILTERS:
        yield f"without .{node.func.attr}", lambda old: old.func.value  # type: ignore[attr-defined]
    elif isinstance(node, ast.Expr | ast.AugAssign):
        yield "left out", lambda old: ast.copy_location(ast.Pass(), old)


_FILTERS = ("drop_duplicates", "dropna", "clip", "abs", "sort_values", "union", "intersection")


def _with_test(node: ast.AST, value: bool) -> ast.AST:
    if isinstance(node, ast.While) and value:
        value = False  # an endless loop shows nothing
    node.test = ast.Constant(value)  # type: ignore[attr-defined]
    return node
