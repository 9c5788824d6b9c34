"""Two branches of a simulation that take turns, so that other load of the machine slows both alike."""

from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.synchronize import Semaphore
from typing import TypeVar

from cosim.core import RoundCore, Steps
from cosim.process.fork import fork
from cosim.sumo import Sumo
from cosim.world.snapshot import StepReport

A = TypeVar("A")
B = TypeVar("B")
R = TypeVar("R")


def side_by_side(world: Sumo, every: int, one: Callable[[], A], other: Callable[[], B]) -> tuple[A, B]:
    """The results of both functions, each run in a branch of its own; they step the world in turns of `every` steps."""
    first, second = (get_context("fork").Semaphore(value) for value in (1, 0))
    together = RoundCore.advance  # many steps in compiled code

    def taking_turns(work: Callable[[], R], mine: Semaphore, theirs: Semaphore) -> R:
        step, count, waited = world.step, 0, -1

        def wait() -> None:
            nonlocal waited
            if count % every == 0 and count != waited:
                if count:
                    theirs.release()
                mine.acquire()
                waited = count

        def in_turn() -> StepReport:
            nonlocal count
            wait()
            count += 1
            return step()

        def together_in_turn(
            core: RoundCore, first: int, decisions: int, most: int, **options: bool
        ) -> tuple[int, int, Steps]:
            nonlocal count
            wait()
            made = together(core, first, decisions, min(most, every - count % every), **options)
            count += len(made[2])
            return made

        world.step = in_turn
        setattr(RoundCore, "advance", together_in_turn)  # noqa: B010
        try:
            return work()
        finally:
            for _ in range(1_000_000 // every):  # the other branch need not wait any more
                theirs.release()

    branches = fork(lambda: taking_turns(one, first, second)), fork(lambda: taking_turns(other, second, first))
    return branches[0].result(), branches[1].result()
