import os
import signal
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from typer.testing import CliRunner

from gri.commands.cli import app, main
from gri.commands.reproduce import TARGETS
from gri.errors import InputError
from gri.paper.plan import TABLES
from gri.relations.reaction_scenes import ReactionPrior
from gri.training.relations.teach_encoder import TeachingSettings

TINY = """\
name: tiny
data: {range: paper, graphs: one, train: 4, validation: 2, test: 2, expert_updates: 1}
objective: {type: gri, updates: 1, reward_updates: 1, batch: 2, return_batch: 2}
decoder: {hidden: 8}
encoder: {hidden: 8}
"""


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_each_command_prints_the_next_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(TINY)
    assert "Next: gri train tiny.yaml" in run("data", "tiny.yaml")
    assert "Next: gri evaluate runs/tiny-s3.safetensors" in run("train", "tiny.yaml", "--seed", "3")
    scored = run("evaluate", "runs/tiny-s3.safetensors")
    assert "RMSE_x" in scored
    assert "2 test scenes" in scored


class StopsAtReport:
    """A display that stops the training by Ctrl-C, at its third report."""

    def __enter__(self) -> "StopsAtReport":
        self.left = 3
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __call__(self, stage: str, done: int, total: int, value: float | str = "") -> None:
        self.left -= 1
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGINT)


def test_a_training_that_is_stopped_goes_on_by_the_same_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(TINY.replace("updates: 1, reward", "updates: 6, reward"))
    run("train", "tiny.yaml", "--out", "straight.safetensors")
    monkeypatch.setattr("gri.commands.models.ProgressDisplay", StopsAtReport)
    out, said = Path("runs/tiny-s0.safetensors"), []
    while not out.exists():
        result = CliRunner().invoke(app, ["train", "tiny.yaml", "--track", "csv"], catch_exceptions=False)
        said.append(result.output)
        assert result.exit_code == (0 if out.exists() else 130)
        assert len(said) < 10
    assert len(said) >= 3
    assert all("going on after update" in output for output in said[1:])
    straight, stopped = (load_file(path) for path in (Path("straight.safetensors"), out))
    assert straight.keys() == stopped.keys()
    assert all(torch.equal(straight[name], stopped[name]) for name in straight)
    assert not out.with_suffix(".state").exists()
    rows = out.with_suffix(".csv").read_text().splitlines()
    assert [row.split(",")[1] for row in rows if row.startswith("encoder and policy")] == [*"123456"]


class FewScenes(TeachingSettings, frozen=True):
    """Defaults with which a teaching takes seconds."""

    prior: ReactionPrior = ReactionPrior(settle=(0.0,))
    scenes: int = 600
    steps: int = 25
    window: tuple[int, int] = (20, 25)
    batch: int = 16
    policy_updates: int = 2


def test_a_teaching_that_is_stopped_goes_on_by_the_same_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(TINY)
    run("train", "tiny.yaml")
    monkeypatch.setattr("gri.training.relations.teach_encoder.TeachingSettings", FewScenes)
    monkeypatch.setattr("gri.training.relations.teach_checkpoint.ROLLOUTS", 500)
    monkeypatch.setattr("gri.training.relations.teach_checkpoint.NOVELTY_SCENES", 400)
    command = ["teach", "runs/tiny-s0.safetensors", "--updates", "4", "--out"]
    assert "taught in" in run(*command, "straight.safetensors")
    monkeypatch.setattr("gri.commands.models.ProgressDisplay", StopsAtReport)
    out, said = Path("taught.safetensors"), []
    while not out.exists():
        result = CliRunner().invoke(app, [*command, out.name], catch_exceptions=False)
        said.append(result.output)
        assert result.exit_code == (0 if out.exists() else 130), result.output
        assert len(said) < 10
    assert len(said) >= 3
    assert all("run the same command again to go on (kept in taught.state)" in output for output in said[:-1])
    assert all("going on after update" in output for output in said[1:])
    straight, stopped = (load_file(path) for path in (Path("straight.safetensors"), out))
    assert straight.keys() == stopped.keys()
    assert all(torch.equal(straight[name], stopped[name]) for name in straight)
    assert not out.with_suffix(".state").exists()


@pytest.mark.parametrize(
    "arguments",
    [["train", "no_such_configuration"], ["evaluate", "no_such_checkpoint"], ["evaluate", "us101_car_following.yaml"]],
)
def test_bad_input_is_one_line_and_code_2(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(sys, "argv", ["gri", *arguments])
    with pytest.raises(SystemExit) as exit:
        main()
    assert exit.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_unknown_configuration_lists_the_known_ones():
    with pytest.raises(InputError, match="paper_car_following"):
        CliRunner().invoke(app, ["train", "no_such_configuration"], catch_exceptions=False)


def test_targets_are_those_of_the_paper():
    assert set(TARGETS) == set(TABLES)
    with pytest.raises(InputError, match="got table9, wanted one of table1, table2"):
        CliRunner().invoke(app, ["reproduce", "table9"], catch_exceptions=False)
