"""The mutants are what they say, and only functions are changed."""

import ast

from tests.mutation.mutants import mutants
from tests.mutation.targets import TARGETS

SOURCE = '''
LIMIT = 3


def f(x, y=1):
    """Adds 1 < 2."""
    if x < 2:
        raise ValueError("1 + 1")
    return [1:2] if False else x[1:] + 1


class C:
    factor = 2

    def m(self):
        return -self.factor
'''.replace("[1:2] if False else ", "")


def test_one_thing_is_changed_at_a_time():
    found = {(mutant.function, ast.unparse(mutant.tree)) for mutant in mutants("m", SOURCE)}
    whole = ast.unparse(ast.parse(SOURCE))
    wanted = (("x < 2", "x <= 2"), ("x < 2", "x < 3"), ("if x < 2", "if False"), ("if x < 2", "if True"))
    wanted += (("x[1:] + 1", "x[1:] - 1"), ("x[1:] + 1", "x + 1"), ("x[1:] + 1", "x[1:] + 2"), ("x[1:]", "x[2:]"))
    assert found == {
        *(("f", whole.replace(before, after)) for before, after in wanted),
        ("C.m", whole.replace("-self", "self")),
    }


def test_every_module_has_mutants_and_its_tests_exist():
    from importlib.util import find_spec
    from pathlib import Path

    for module, tests in TARGETS.items():
        spec = find_spec(module)
        assert spec is not None
        assert sum(1 for _ in mutants(module, Path(str(spec.origin)).read_text(encoding="utf-8"))) > 10, module
        assert all(Path(test).is_file() for test in tests)
