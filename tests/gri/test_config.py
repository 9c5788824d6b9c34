from pathlib import Path

import msgspec
import pytest

from gri import resources
from gri.config import read_yaml
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
        ("graphs: one", "graphs: one\n  graphs: one", 4, "field graphs is given twice"),
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


def test_a_date_that_is_none_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="not valid YAML"):
        read_train_config(written(tmp_path, GOOD.replace("small", "2001-99-99")))


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
