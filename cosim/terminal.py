"""How commands speak: results to standard output, progress and errors to standard error."""

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

console = Console(highlight=False)
errors = Console(stderr=True, highlight=False)


def say(text: str) -> None:
    console.print(text, soft_wrap=True)


def next_command(command: str) -> None:
    """Tell the next command a person would type."""
    console.print(f"Next: [bold]{command}[/bold]", soft_wrap=True)


class Stages:
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

    def __enter__(self) -> "Stages":
        if errors.is_terminal:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if errors.is_terminal:
            self._bars.stop()

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
