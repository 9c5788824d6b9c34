"""What the commands `gri` and `cosim` show: results on standard output, progress and errors on standard error.

`say`, `next_command` and `fail` write text; `show_tables` writes tables in the format that a person asks for;
`ProgressDisplay` shows how far long work is.
"""

import codecs
import io
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from gri.errors import InputError
from gri.table import WRITERS, Table, TableFormat, terminal_text

console = Console(highlight=False)
errors = Console(stderr=True, highlight=False)
TENTHS = 10  # plain lines per stage, besides its first one
PLAIN = {"−": "-", "–": "-", "─": "-", "·": "*", "×": "x", "±": "+-", "≤": "<=", "≥": ">=", "≠": "!=", "→": "->"}
PLAIN |= {"²": "2", "³": "3", "⁻": "-", "½": "1/2", "…": "...", "Δ": "d", "τ": "tau", "σ": "sigma", "μ": "mu"}
"""What stands for a character where the terminal has none of it. A minus sign above all must not get lost."""

ShowProgress = Callable[..., None]
"""(stage, units done, units in all, remark or value of the objective); can serve as a `gri.progress.Progress`."""


def use_any_encoding() -> None:
    """Let the process print where the character set of its output lacks some of the text, as with LC_ALL=C it may."""
    codecs.register_error("plain", _plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")


def _plain(error: UnicodeError) -> tuple[str, int]:
    """What to write instead of the characters that cannot be encoded, and where to go on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(PLAIN.get(character, "?") for character in missing), error.end


def say(text: str) -> None:
    """Write a line as it is; square brackets are text, not markup."""
    console.print(text, markup=False, soft_wrap=True)


def next_command(command: str) -> None:
    """Show the command that a person would type next."""
    console.print(Text.assemble("Next: ", (command, "bold")), soft_wrap=True)


FormatOption = Annotated[
    TableFormat,
    typer.Option("--format", help="How to print: a table for reading, Markdown, or all numbers as csv or json."),
]


def show_tables(tables: Sequence[Table], kind: TableFormat, *remarks: str, then: str = "") -> None:
    """Write tables, remarks about them, and the command that a person would type next.

    In Markdown, CSV and JSON standard output holds the tables alone; the remarks go to standard error.
    """
    if kind == "table":
        for k, table in enumerate(tables):
            say(("\n" if k else "") + terminal_text(table, console.width))
        for remark in remarks:
            say(remark)
        if then:
            next_command(then)
        return
    sys.stdout.write(WRITERS[kind](tables))
    for remark in remarks:
        notice(remark)


def notice(text: str) -> None:
    """Write a line to standard error."""
    errors.print(text, markup=False, soft_wrap=True)


def fail(message: str, code: int) -> NoReturn:
    """Write an error in one line and end the process with an exit code."""
    notice(f"error: {message}")
    sys.exit(code)


def finite(value: Any) -> Any:
    """The value of an option, for the `callback` of typer. Raises `InputError` for a number that is not finite."""
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, float) and not math.isfinite(number):
            raise InputError(f"an option is {number}, expected a finite number; correct it")
    return value


def show_version(command: str) -> NoReturn:
    """Write the version of the installed package and end the process."""
    say(f"{command} {version('gri-cosim')}")
    sys.exit(0)


class ProgressDisplay:
    """A bar per stage in a terminal; elsewhere a plain line when a stage begins and after every tenth of it.

    `with ProgressDisplay() as progress:` gives the function to report with, such as `progress("warm-up", 100, 300)`.
    Rate and remaining time are added where they are known.
    """

    def __init__(self) -> None:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}", markup=False),
        )
        self._bars = Progress(*columns, TimeElapsedColumn(), console=errors)
        self._stages: dict[str, _Stage] = {}

    def __enter__(self) -> ShowProgress:
        if errors.is_terminal:
            self._bars.start()
        return self._show

    def __exit__(self, *_: object) -> None:
        if errors.is_terminal:
            self._bars.stop()

    def _show(self, stage: str, done: int, total: int, value: float | str = "", /) -> None:
        known = self._stages.get(stage)
        if known is None or done < known.done:  # a stage of this name begins, perhaps once more
            bar = self._bars.add_task(stage, total=total, note="") if known is None else known.bar
            known = self._stages[stage] = _Stage(bar, time.monotonic(), done, -1, done)
        tenth, known.done = TENTHS * done // max(total, 1), done
        note = _note(value, known, done, total)
        if errors.is_terminal:
            self._bars.update(known.bar, completed=done, total=total, note=note)
        elif tenth > known.tenth:
            notice(f"{stage}: {done}/{total}{note and ', '}{note}")
        known.tenth = tenth


@dataclass
class _Stage:
    bar: TaskID
    began: float  # [s] on the monotonic clock
    before: int  # units done when it began here, which do not count for the rate
    tenth: int  # the last tenth that was shown
    done: int


def _note(value: float | str, stage: _Stage, done: int, total: int) -> str:
    """The remark or objective, the rate and the remaining time, as far as they are known."""
    notes = [value if isinstance(value, str) else f"{value:.4g}"] if value else []
    seconds = time.monotonic() - stage.began
    if done > stage.before and seconds > 0:
        rate = (done - stage.before) / seconds
        notes.append(f"{rate:.1f}/s" if rate >= 1 else f"{60 * rate:.1f}/min")
        notes += [f"{_clock((total - done) / rate)} left"] if done < total else []
    return ", ".join(notes)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {rest:02} s" if minutes else f"{rest} s"
