"""How commands speak: results to standard output, progress and errors to standard error."""

import time
from abc import ABC
from dataclasses import dataclass
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

console = Console(highlight=False)
errors = Console(stderr=True, highlight=False)


def say(text: str) -> None:
    console.print(text, soft_wrap=True)


def next_command(command: str) -> None:
    """Tell the next command a person would type."""
    console.print(f"Next: [bold]{command}[/bold]", soft_wrap=True)


# typing.Self would say the same, but the run-time type checker of the tests cannot follow it here.
B = TypeVar("B", bound="_Bars")


class _Bars(ABC):
    """Bars that are shown in a terminal only, as long as the block lasts."""

    _bars: Progress

    def __enter__(self: B) -> B:
        if errors.is_terminal:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if errors.is_terminal:
            self._bars.stop()


class Stages(_Bars):
    """A bar per stage in a terminal; elsewhere a plain line per stage and per quarter of it."""

    def __init__(self) -> None:
        columns = (
            TextColumn("{task.description:>10}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}"),
        )
        self._bars = Progress(*columns, TimeElapsedColumn(), console=errors)
        self._stages: dict[str, int] = {}
        self._plain: dict[str, int] = {}

    def tell(self, stage: str, done: int, of: int) -> None:
        if not errors.is_terminal:
            quarter = 4 * done // max(of, 1)
            if quarter > self._plain.get(stage, -1):
                self._plain[stage] = quarter
                errors.print(f"{stage}: {done}/{of}", highlight=False)
            return
        if stage not in self._stages:
            self._stages[stage] = self._bars.add_task(stage, total=of)
        self._bars.update(self._stages[stage], completed=done, total=of)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Tally:
    """Where a batch stands: runs in all, finished, failed for good, and ended before this command began."""

    total: int
    done: int
    failed: int
    before: int

    @property
    def left(self) -> int:
        return self.total - self.done - self.failed


class Runs(_Bars):
    """Progress of a batch: a bar in a terminal; elsewhere a plain line per 5 % and at least every half minute."""

    def __init__(self) -> None:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
        )
        self._bars = Progress(*columns, console=errors)
        self._began = self._told = time.monotonic()
        self._bar: TaskID | None = None
        self._share = -1

    def tell(self, tally: Tally) -> None:
        ended, now = tally.done + tally.failed, time.monotonic()
        note = self._note(tally, now - self._began)
        if errors.is_terminal:
            if self._bar is None:
                self._bar = self._bars.add_task("runs", total=tally.total, note="")
            self._bars.update(self._bar, completed=ended, note=note)
        elif 20 * ended // tally.total > self._share or now - self._told > 30:
            self._share, self._told = 20 * ended // tally.total, now
            errors.print(f"runs: {ended}/{tally.total}{note and ', '}{note}", highlight=False)

    def _note(self, tally: Tally, seconds: float) -> str:
        """Failures, rate and remaining time, as far as they are known."""
        ended = tally.done + tally.failed - tally.before
        notes = [f"{tally.failed} failed"] if tally.failed else []
        if ended > 0 and seconds > 0:
            rate = ended / seconds
            notes += [f"{rate:.2f} runs/s" if rate >= 1 else f"{60 * rate:.1f} runs/min"]
            notes += [f"{_clock(tally.left / rate)} left"] if tally.left else []
        return ", ".join(notes)


class SceneProgress(_Bars):
    """Progress of scenes with their rate: a bar in a terminal; elsewhere a plain line per 5 %."""

    def __init__(self) -> None:
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}")
        self._bars = Progress(*columns, TimeElapsedColumn(), console=errors)
        self._bar: TaskID | None = None
        self._first: tuple[float, int] | None = None
        self._share = -1

    def tell(self, done: int, of: int) -> None:
        """So many scenes are there; what was there at the first call does not count for the rate."""
        now = time.monotonic()
        began, before = self._first = self._first or (now, done)
        note = f"{(done - before) / (now - began):.1f} scenes/s" if done > before else ""
        if errors.is_terminal:
            if self._bar is None:
                self._bar = self._bars.add_task("scenes", total=of, note="")
            self._bars.update(self._bar, completed=done, note=note)
        elif 20 * done // of > self._share:
            self._share = 20 * done // of
            errors.print(f"scenes: {done}/{of}{note and ', '}{note}", highlight=False)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min {rest:02} s"
