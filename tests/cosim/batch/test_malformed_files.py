"""Two hundred broken batch files, made from good ones by mutation: each is refused with file, field and reason."""

import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from cosim.batch.run_matrix import expand, load_batch
from cosim.commands.cli import main
from gri.errors import InputError
from tests.command_line import in_this_process
from tests.cosim.batch.test_run_matrix import GOOD

COUNT = 200
WRONG: tuple[Any, ...] = (None, "nonsense", -1, 1e400, [], {}, [[]], {"a": 1}, "2001-01-01", True)
STRAY = ("\t", "}", "]", ": :", "\x00", "&a *a", "!!python/object:os.system ", "%")
Mutation = Callable[[random.Random, Any], str]


def _places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The path of everything inside a mapping or list."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [place for key, value in items for place in [(*path, key), *_places(value, (*path, key))]]


def _parent(content: Any, place: tuple[Any, ...]) -> Any:
    for key in place[:-1]:
        content = content[key]
    return content


def _misspell(rng: random.Random, content: Any) -> str:
    place = rng.choice([place for place in _places(content) if isinstance(place[-1], str)])
    parent = _parent(content, place)
    parent[place[-1] + rng.choice("sxq")] = parent.pop(place[-1])
    return yaml.safe_dump(content, sort_keys=False)


def _replace(rng: random.Random, content: Any) -> str:
    place = rng.choice(_places(content))
    _parent(content, place)[place[-1]] = rng.choice(WRONG)
    return yaml.safe_dump(content, sort_keys=False)


def _repeat(rng: random.Random, content: Any) -> str:
    text = yaml.safe_dump(content, sort_keys=False)
    lines = [line for line in text.splitlines() if line and line[0].isalpha()]
    return f"{text}{rng.choice(lines)}\n"


def _cut(rng: random.Random, content: Any) -> str:
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=True)[: rng.randrange(20, 300)]


def _scatter(rng: random.Random, content: Any) -> str:
    text = yaml.safe_dump(content, sort_keys=False)
    at = rng.randrange(len(text))
    return (
        text[:at] + rng.choice(["\t", "}", "]", ": :", "\x00", "&a *a", "!!python/object:os.system ", "%"]) + text[at:]
    )


MUTATIONS: tuple[Mutation, ...] = (_misspell, _replace, _repeat, _cut, _scatter)


@pytest.fixture(scope="module")
def broken(tmp_path_factory) -> dict[Path, str]:
    """Two hundred files that are refused, with what is said about each; mutations that do no harm are passed over."""
    folder, rng = tmp_path_factory.mktemp("broken"), random.Random(1)
    found: dict[Path, str] = {}
    for k in range(20 * COUNT):
        path = folder / f"broken{k}.yaml"
        path.write_text(MUTATIONS[k % len(MUTATIONS)](rng, yaml.safe_load(GOOD)), encoding="utf-8")
        began = time.process_time()
        try:
            expand(*load_batch(str(path)))
        except InputError as error:
            found[path] = str(error)
        assert time.process_time() - began < 1.0, path.read_text()
        if len(found) == COUNT:
            break
    return found


def test_all_of_them_are_refused_with_their_file_and_a_reason(broken):
    assert len(broken) == COUNT
    for path, message in broken.items():
        assert message.startswith(str(path)), message
        assert "\n" not in message, message
        assert len(message) > len(str(path)) + 15, message


def test_nearly_all_name_the_line(broken):
    """What is wrong about a file as a whole, say a missing field, has no line."""
    with_line = [message for path, message in broken.items() if message.removeprefix(f"{path}:")[:1].isdigit()]
    assert len(with_line) > 0.7 * COUNT


def test_the_command_refuses_each_in_one_line_and_runs_none(broken):
    for path in broken:
        done = in_this_process(main, "batch", path.name, "--out", "never", cwd=path.parent)
        assert done.returncode == 2, (path.read_text(), done.stderr)
        assert "Traceback" not in done.stderr
        assert done.stdout == ""
        assert not (path.parent / "never").exists()
