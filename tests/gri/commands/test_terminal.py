import pytest

from gri.commands.terminal import Bar, console


@pytest.mark.skipif(console.is_terminal, reason="lines are written where there is no terminal")
def test_a_log_has_a_line_for_every_tenth(capsys: pytest.CaptureFixture[str]):
    with Bar() as progress:
        for done in (7, 99, 101, 102, 350, 1000):
            progress("reading", done, 1000, 0.5)
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    assert lines == ["reading 101/1000 0.5", "reading 350/1000 0.5", "reading 1000/1000 0.5"]
