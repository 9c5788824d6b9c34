"""The mutants are what they say, and only functions are changed."""

import ast
import json
from importlib.util import find_spec
from pathlib import Path

from tests.mutation.equivalent import EQUIVALENT
from tests.mutation.mutants import mutants
from tests.mutation.session import Chosen, keys_of
from tests.mutation.targets import TARGETS
from tests.mutation.which_tests import Watch

pytest_plugins = ["pytester"]

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


def test_a_sixth_of_the_mutants_can_be_kept_for_later():
    keys = [f"m: f: x: {k}" for k in range(600)]
    kept, others = Chosen(1, 0, 7).of(keys), Chosen(2, 0, 7, without=True).of(keys)
    assert sorted(kept + others) == sorted(Chosen(1, 0).of(keys)) == list(range(600))
    assert 70 < len(kept) < 130
    assert {keys[k] for k in kept} >= {keys[k] for k in Chosen(1, 10, 7).of(keys)}
    assert {f"{keys[k]}" for k in kept} == {("x", *keys)[k] for k in Chosen(1, 0, 7).of(("x", *keys)) if k}


def test_a_mutant_keeps_its_key_when_lines_move():
    keys = keys_of(list(mutants("m", SOURCE)))
    assert len(set(keys)) == len(keys)
    assert keys_of(list(mutants("m", "X = 4\n" + SOURCE))) == keys


def test_every_module_has_mutants_and_its_tests_exist():
    for module, tests in TARGETS.items():
        spec = find_spec(module)
        assert spec is not None
        assert sum(1 for _ in mutants(module, Path(str(spec.origin)).read_text(encoding="utf-8"))) > 10, module
        assert all(Path(test).is_file() for test in tests)


def test_every_equivalent_mutant_is_one_that_exists():
    """Else the entry is of older code, or hides others."""
    keys = {
        key
        for module in {name.partition(":")[0] for name in EQUIVALENT}
        for key in keys_of(
            list(mutants(module, Path(str(getattr(find_spec(module), "origin", ""))).read_text(encoding="utf-8")))
        )
    }
    assert set(EQUIVALENT) - keys == set()


def test_a_watched_run_knows_the_tests_of_a_function(pytester):
    pytester.makepyfile(
        test_it="""
        import json, pytest
        @pytest.fixture(scope="module")
        def text(): return json.dumps([])
        def test_loads(): json.loads("[]")
        def test_text(text): pass
        def test_other(text): pass
        """
    )
    watch = Watch({"dumps": json.dumps.__code__, "loads": json.loads.__code__, "load": json.load.__code__})
    assert pytester.inline_run("-p", "no:cacheprovider", plugins=[watch]).ret == 0
    found = {name: set(tests) for name, tests in watch.found().items()}
    every = {f"test_it.py::test_{name}" for name in ("loads", "text", "other")}
    assert found == {"loads": {"test_it.py::test_loads"}, "dumps": every}
    assert set(watch.found({"loads", "load"})["loads"]) == every
