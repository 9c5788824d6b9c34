"""What commands show on the terminal: progress, and the next command."""

from collections.abc import Callable

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

console = Console()


class Bar:
    """A progress display, or lines where there is no terminal, that can be called as a `gri.progress.Progress`."""

    def __init__(self) -> None:
        columns = [TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}")]
        self.display = Progress(
            *columns, TextColumn("{task.fields[value]:.4g}"), TimeRemainingColumn(), console=console
        )
        self.tasks: dict[str, TaskID] = {}
        self.tenths: dict[str, int] = {}

    def __enter__(self) -> Callable[[str, int, int, float], None]:
        self.display.__enter__()
        return self._show

    def __exit__(self, *error: object) -> None:
        self.display.stop()

    def _show(self, what: str, done: int, total: int, value: float) -> None:
        if not console.is_terminal:  # a line for every tenth, so that a log file can be watched
            if done * 10 // total > self.tenths.get(what, 0):
                console.print(f"{what} {done}/{total} {value:.4g}")
            self.tenths[what] = done * 10 // total
            return
        if what not in self.tasks:
            self.tasks[what] = self.display.add_task(what, total=total, value=value)
        self.display.update(self.tasks[what], completed=done, value=value)


def next_command(command: str) -> None:
    """Show the command a person would type next."""
    console.print(f"next: [bold]{command}[/bold]", soft_wrap=True)
