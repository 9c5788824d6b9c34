"""The files that a scenario names: where they are looked for, and what is said about those that are broken."""

import gzip
import sys
from pathlib import Path

import msgspec
import pytest

from cosim.spec.input_files import find_net, source_path
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import UserPolicy
from gri.errors import InputError
from gri.resources import shipped

NET = shipped("sumo_nets", "us101", "us101.net.xml")


def scenario_with(folder: Path, **changes: object) -> str:
    content = msgspec.to_builtins(load_scenario("us101_car_following")) | changes
    (folder / "mine.yaml").write_bytes(msgspec.yaml.encode(content))
    return str(folder / "mine.yaml")


def test_files_are_looked_for_beside_the_scenario_first(tmp_path, monkeypatch):
    for name in ("a.net.xml", "b.net.xml.gz", "mine.py", "my.pt", "my.csv"):
        (tmp_path / name).write_text("<net/>")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "a.net.xml").write_text("another one")
    monkeypatch.chdir(elsewhere)
    own = {"kind": "python", "object": "mine.py:Mine"}
    loaded = load_scenario(scenario_with(tmp_path, net="a.net.xml", policy=own))
    assert loaded.net == str(tmp_path / "a.net.xml")
    assert isinstance(loaded.policy, UserPolicy)
    assert loaded.policy.object == f"{tmp_path / 'mine.py'}:Mine"
    trained = {"kind": "gri", "checkpoint": "my.pt"}
    replay = {"kind": "replay", "recording": "my.csv", "lane_1": 0.0}
    content = msgspec.to_builtins(load_scenario(scenario_with(tmp_path, policy=trained, background=replay)))
    assert content["net"] == "us101"
    assert content["policy"]["checkpoint"] == str(tmp_path / "my.pt")
    assert content["background"]["recording"] == str(tmp_path / "my.csv")


def test_a_compressed_net_is_a_net(tmp_path):
    (tmp_path / "x.net.xml.gz").write_bytes(gzip.compress(NET.read_bytes()))
    assert find_net(str(tmp_path / "x.net.xml.gz")) == tmp_path / "x.net.xml.gz"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'<?xml version="1.0" encoding="foo"?><net/>', "unknown encoding"),
        (b'<?xml version="1.0" encoding="utf-7"?><net/>', "not well-formed XML"),
        (b"<net><edge></net>", "bad.net.xml:1: not well-formed XML"),
        (b"", "not well-formed XML"),
        (b"<routes/>", "got a <routes> file, expected a SUMO <net>"),
        (gzip.compress(NET.read_bytes())[:1000], "not well-formed XML"),
        (b"\x1f\x8b junk", "not well-formed XML"),
        (b"<!DOCTYPE l [<!ENTITY a 'aaaaaaaaaa'>" + b"".join(
            b"<!ENTITY a%d '%s'>" % (k, (b"&a%d;" % (k - 1) if k else b"&a;") * 10) for k in range(12)
        ) + b"]><net>&a11;</net>", "not well-formed XML"),
    ],
    ids=["no encoding", "utf-7", "tags", "empty", "routes", "cut gzip", "no gzip", "entities"],
)  # fmt: skip
def test_what_is_no_net_is_refused_in_one_line(tmp_path, content, message):
    (tmp_path / "bad.net.xml").write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        find_net(str(tmp_path / "bad.net.xml"))
    assert "\n" not in str(error.value)


def test_a_net_that_is_repaired_is_read_again(tmp_path):
    path = tmp_path / "x.net.xml"
    path.write_text("<net>")
    with pytest.raises(InputError):
        find_net(str(path))
    path.write_text("<net></net>")
    assert find_net(str(path)) == path


@pytest.mark.parametrize("name", ["x" * 300, "a/" * 400, "", "."])
def test_a_name_that_no_file_can_have_is_refused(name):
    with pytest.raises(InputError, match="no net"):
        find_net(name)


def test_the_source_of_a_module_is_found_without_importing_its_package(tmp_path, monkeypatch):
    package = tmp_path / "some_package"
    (package / "inner").mkdir(parents=True)
    for folder in (package, package / "inner"):
        (folder / "__init__.py").write_text("raise SystemExit('this code must not run')")
    (package / "inner" / "mine.py").write_text("raise SystemExit('nor this')")
    monkeypatch.syspath_prepend(tmp_path)
    assert source_path(UserPolicy(object="some_package.inner.mine:Mine")) == package / "inner" / "mine.py"
    assert not any(name.startswith("some_package") for name in sys.modules)
    for missing in ("some_package.inner.other:Mine", "some_package.inner.mine.deeper:Mine", "no_such:Mine", "..:Mine"):
        with pytest.raises(InputError, match="no module"):
            source_path(UserPolicy(object=missing))
