"""A call that ends or hangs its process is found out, and the function gets to its end without it."""

import os
import signal
import time

import pytest

from cosim.process.fork import CAN_FORK, BranchError
from cosim.process.guarded_calls import CallGuard, FatalCall, survive

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="needs fork")


def five_calls(guard: CallGuard, fatal) -> list[str]:
    """What five calls answer, or why they could not; `fatal` is called third."""
    answers = []
    for k in range(5):
        try:
            answers.append(guard.call(fatal if k == 2 else lambda k=k: f"answer {k}"))
        except FatalCall as end:
            answers.append(str(end))
            break
    return answers


@pytest.mark.parametrize(
    ("fatal", "reason"),
    [
        (lambda: os._exit(7), "ended its process (exit code 7)"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "ended its process (SIGKILL)"),
        (lambda: time.sleep(60), "gave no answer within 0.3 s"),
        (lambda: "answer 2", "answer 2"),
    ],
    ids=["exit", "kill", "hang", "none"],
)
def test_what_was_before_the_fatal_call_is_kept(fatal, reason):
    began = time.monotonic()
    answers = survive(lambda guard: five_calls(guard, fatal), limit=0.3)
    assert answers[:3] == ["answer 0", "answer 1", reason]
    assert len(answers) == (5 if reason == "answer 2" else 3)
    assert time.monotonic() - began < 10


def test_a_call_that_ends_the_process_sooner_the_second_time_is_found_out_too(tmp_path):
    def function(guard: CallGuard) -> int:
        def call() -> None:
            if guard.calls == 3 or (tmp_path / "second copy").exists():
                (tmp_path / "second copy").touch()
                os._exit(1)

        for done in range(5):
            try:
                guard.call(call)
            except FatalCall:
                return done
        return 5

    assert survive(function, limit=5.0) == 0


def test_what_happens_outside_guarded_calls_is_an_error():
    with pytest.raises(BranchError, match="exit code 3"):
        survive(lambda guard: os._exit(3), limit=1.0)
    with pytest.raises(BranchError, match="ZeroDivisionError"):
        survive(lambda guard: guard.call(lambda: 1 / 0), limit=1.0)
