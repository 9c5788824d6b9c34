"""The README's promises."""

import re
from pathlib import Path

import pandas as pd

from cosim.world.episode import COLUMNS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_python_examples_run(tmp_path, monkeypatch):
    run = tmp_path / "runs/us101_car_following-gri-seed1"
    run.mkdir(parents=True)
    row = {"driver": "gri", "driven": True, "role": 0, "jerk": 0.1} | dict.fromkeys(COLUMNS, 0.0)
    pd.DataFrame([row, row]).to_parquet(run / "steps.parquet")
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert examples
    for example in examples:
        exec(compile(example, "README.md", "exec"), {})


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert target.startswith("https://") or (ROOT / target).exists(), target


def test_the_gate_installs_as_the_readme_says():
    gate = (ROOT / ".ci/run").read_text()
    assert "pip install -c .ci/constraints.txt -e '.[test]'" in README
    assert "-c .ci/constraints.txt -e '.[test]'" in gate
