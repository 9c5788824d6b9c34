"""The course of a training for trackers: the objective after every update, as a CSV file or for TensorBoard.

TensorBoard needs the extra `track`. Both are written while the training goes on, and continued if it is resumed.
"""

import csv
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Literal

from gri.errors import InputError
from gri.progress import Progress
from gri.storage.whole_files import remove

Tracker = Literal["csv", "tensorboard"]
COLUMNS = ("stage", "update", "updates", "objective", "seconds")


@contextmanager
def tracked(progress: Progress, trackers: Sequence[Tracker], place: Path) -> Iterator[Progress]:
    """A `Progress` that tells `progress` and every tracker. `place` is the path of their files without a suffix.

    Raises `InputError` if a tracker is not installed.
    """
    with ExitStack() as open_files:
        listeners = [progress, *(_OPEN[name](place, open_files) for name in dict.fromkeys(trackers))]

        def tell(stage: str, done: int, total: int, value: float) -> None:
            for listener in listeners:
                listener(stage, done, total, value)

        yield tell


def remove_tracks(place: Path) -> None:
    """Remove what trackers wrote of an earlier training at the same place."""
    for suffix in (".csv", ".tensorboard"):
        remove(place.with_suffix(suffix))


def _csv(place: Path, open_files: ExitStack) -> Progress:
    path = place.with_suffix(".csv")
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh, began = not path.exists(), time.monotonic()
    # One line at a time: a training that is killed leaves whole rows.
    file = open_files.enter_context(path.open("a", newline="", encoding="utf-8", buffering=1))
    rows = csv.writer(file)
    if fresh:
        rows.writerow(COLUMNS)

    def note(stage: str, done: int, total: int, value: float) -> None:
        rows.writerow([stage, done, total, repr(float(value)), round(time.monotonic() - began, 3)])

    return note


def _tensorboard(place: Path, open_files: ExitStack) -> Progress:
    try:
        from torch.utils.tensorboard.writer import SummaryWriter
    except ImportError:
        raise InputError("--track tensorboard needs TensorBoard: pip install 'gri-cosim[track]'") from None
    writer = SummaryWriter(str(place.with_suffix(".tensorboard")))
    open_files.callback(writer.close)

    def note(stage: str, done: int, total: int, value: float) -> None:
        del total
        writer.add_scalar(f"objective/{stage}", value, done)

    return note


_OPEN: dict[str, Callable[[Path, ExitStack], Progress]] = {"csv": _csv, "tensorboard": _tensorboard}
