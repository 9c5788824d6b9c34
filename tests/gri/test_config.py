import os
import time
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gri import resources
from gri.config import parsed, read_yaml
from gri.errors import InputError
from gri.training.adversarial.airl import AdversarialSettings
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import TrainConfig, model_config, read_train_config

GOOD = """\
name: small
data:
  range: paper
  graphs: one
objective:
  type: gri
  shifts:
    position: [0.0, 3.0]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "train.yaml"
    path.write_text(text)
    return path


def test_a_good_file(tmp_path: Path):
    config = read_train_config(written(tmp_path, GOOD))
    assert isinstance(config.objective, GroundedSettings)
    assert config.objective.shifts.position == (0.0, 3.0)
    assert model_config(config).history_steps == 20


def test_the_objective_is_chosen_by_its_type(tmp_path: Path):
    text = GOOD.split("objective:")[0] + "objective:\n  type: airl\n  encoder: literal\n"
    config = read_train_config(written(tmp_path, text))
    assert isinstance(config.objective, AdversarialSettings)
    assert config.objective.encoder == "literal"


def test_a_supervised_model_has_no_encoder(tmp_path: Path):
    text = GOOD.split("objective:")[0] + "objective:\n  type: supervised\n"
    assert model_config(read_train_config(written(tmp_path, text))).encoder is None


@pytest.mark.parametrize(
    ("change", "to", "line", "message"),
    [
        ("name: small", "nam: small", 1, "field nam: .*unknown field"),
        ("graphs: one", "graphs: two", 4, "field data.graphs: .*two"),
        ("type: gri", "type: irl", 6, "field objective.type: .*irl"),
        ("  shifts:", "  updates: many\n  shifts:", 7, "field objective.updates: expected `int`, got `str`"),
        ("    position", "    positions", 8, "field objective.shifts.positions: .*unknown field"),
        ("[0.0, 3.0]", "[0.0]", 8, "field objective.shifts.position: .*length"),
        ("[0.0, 3.0]", "[0.0, x]", 8, r"field objective.shifts.position\[1\]: expected `float`, got `str`"),
        ("[0.0, 3.0]", "[0.0, 3.0", 9, "not valid YAML"),
        ("graphs: one", "graphs: one\n  graphs: one", 5, "field graphs is given twice"),
        ("[0.0, 3.0]", "[0.0, 1.0e+400]", 8, r"got 1.0e\+400, expected a finite number"),
        ("[0.0, 3.0]", f"[0.0, 1{'0' * 5000}]", 8, r"got 1000.*5001 digits|a number of 5001"),
        ("name: small", "name: !!bool small", 1, "got the tag !!bool; write the value without a tag"),
        ("name: small", "? [name]\n: small", 1, "got the field name a list or mapping"),
        ("name: small", "1.0: small", 1, r"got the field name 1\.0, expected a word"),
        ("name: small", 'name: "\\0"', 1, "control character"),
        ("name: small", 'name: "\\ud800"', 1, "control character|not valid YAML"),
        ("name: small", "name: 12", 1, "expected `str`, got `int`; text that looks like a number needs quotes"),
        ("name: small", f"name: {'[' * 50}", 1, "more than 40 levels of nesting"),
        ("[0.0, 3.0]", "[0.0, .inf]", 8, "got .inf, expected a finite number"),
        ("[0.0, 3.0]", "&a [0.0, *a]", 8, "refers to content that contains it"),
    ],
)
def test_mistakes_are_named_with_line_and_field(tmp_path: Path, change: str, to: str, line: int, message: str):
    path = written(tmp_path, GOOD.replace(change, to))
    with pytest.raises(InputError, match=message) as error:
        read_train_config(path)
    assert str(error.value).startswith(f"{path}:{line}: ")
    assert "\n" not in str(error.value)


def test_a_missing_field_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=r"field data\.range: .*missing required field"):
        read_train_config(written(tmp_path, GOOD.replace("  range: paper\n", "")))


def test_dates_times_and_words_are_text_and_a_plain_exponent_is_a_number(tmp_path: Path):
    path = written(tmp_path, "[2026-02-30, 1:30:00, yes, on, 010, 0x10, 1_000, 1e5, -2.5E-1, +3, true, ~]")
    texts = ["2026-02-30", "1:30:00", "yes", "on", "010", "0x10", "1_000"]
    assert parsed(path) == [*texts, 1e5, -0.25, 3, True, None]


def test_merge_keys_and_anchors_still_work(tmp_path: Path):
    path = written(tmp_path, "base: &b {x: 1, y: 2}\nmine: {<<: *b, y: 3}\nother: *b\n")
    assert parsed(path) == {"base": {"x": 1, "y": 2}, "mine": {"x": 1, "y": 3}, "other": {"x": 1, "y": 2}}


@pytest.mark.parametrize(
    "text",
    [
        "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n"
        + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 9)),
        "a0: &a0 {x: 1}\n" + "".join(f"a{k}: &a{k} {{<<: [{', '.join([f'*a{k - 1}'] * 10)}]}}\n" for k in range(1, 9)),
        "a0: &a0 [x]\n" + "".join(f"a{k}: &a{k} [*a{k - 1}]\n" for k in range(1, 3000)),
        "x: " + "[" * 3000,
        "x: " + "{a: " * 3000,
        "- " * 3000,
        "".join(f"k{k}: 1\n" for k in range(30_000)),
        "x: " + "[1, " * 30 + "1" + ", 1" * 400_000,
        "x" * (2**20 + 1),
    ],
    ids=["aliases", "merges", "chain", "lists", "mappings", "dashes", "keys", "values", "bytes"],
)
def test_content_without_end_is_refused_soon(tmp_path: Path, text: str):
    path, began = written(tmp_path, text), time.process_time()
    with pytest.raises(InputError, match=r"levels of nesting|more than 20000 values|MiB of YAML"):
        parsed(path)
    assert time.process_time() - began < 10


def test_what_is_no_file_is_refused(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "half.yaml").write_text('name: "\\Uffffffff"')
    with pytest.raises(InputError, match="not valid YAML"):
        parsed(tmp_path / "half.yaml")
    for path in (tmp_path, tmp_path / "pipe", Path("/dev/zero"), tmp_path / ("x" * 300)):
        with pytest.raises(InputError, match="cannot be read"):
            parsed(path)


@given(st.binary(max_size=200) | st.text(alphabet="ab1.-:#&*!<>[]{},'\"|%@\n\t ?~\\", max_size=80).map(str.encode))
@settings(max_examples=300, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_are_content_or_refused_in_one_line(tmp_path: Path, content: bytes):
    path = tmp_path / "any.yaml"
    path.write_bytes(content)
    error = None
    try:
        parsed(path)
    except InputError as refusal:
        error = str(refusal)
    assert "\n" not in (error or "")


def test_no_scenes_are_refused(tmp_path: Path):
    with pytest.raises(InputError, match=r"field data\.test: got 0"):
        read_train_config(written(tmp_path, GOOD.replace("  graphs: one", "  graphs: one\n  test: 0")))


def test_missing_and_binary_files_are_named(tmp_path: Path):
    with pytest.raises(InputError, match="cannot be read"):
        read_yaml(tmp_path / "none.yaml", TrainConfig)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        read_yaml(tmp_path / "binary.yaml", TrainConfig)


@pytest.mark.parametrize("path", sorted(resources.shipped("scenarios", "train").glob("*.yaml")), ids=lambda p: p.stem)
def test_shipped_configurations_are_valid_and_named_after_their_file(path: Path):
    config = read_train_config(path)
    assert config.name == path.stem
    assert msgspec.convert(msgspec.to_builtins(config), TrainConfig) == config
