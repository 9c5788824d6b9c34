"""Processes that wait in a state, and answer questions in copies."""

import os
import signal
import time

import pytest

from cosim.process.fork import CAN_FORK
from cosim.process.frozen_process import FrozenError, Handler, freeze

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork")


def counting_from(steps: int) -> Handler:
    """Answers a number with as many steps more, and waits there; other questions by their kind."""

    def handle(question):
        if isinstance(question, int):
            return (steps + question, os.getpid()), counting_from(steps + question)
        match question:
            case "state":
                return (steps, os.getpid()), None
            case "state", process:
                return (process, os.getpid()), None
            case "fails to prepare":
                return "as it is", None
            case "large":
                return "x" * 5_000_000, None
            case "fails":
                raise ValueError("no such question")
            case "dies":
                os.kill(os.getpid(), signal.SIGKILL)
            case "hangs":
                time.sleep(60)
        return None, None

    def prepare(question):
        match question:
            case "prepared":
                return "state", os.getpid()
            case "fails to prepare":
                raise ValueError
        return question

    return Handler(handle, prepare)


@pytest.fixture
def root():
    return freeze(counting_from(0))


def test_each_question_is_answered_in_a_copy_of_the_waiting_process(root):
    (first, one), _ = root.ask("state")
    (second, other), _ = root.ask("state")
    assert (first, second) == (0, 0)
    assert len({one, other, os.getpid()}) == 3


def test_a_question_is_prepared_in_the_waiting_process(root):
    (process, copy), _ = root.ask("prepared")
    (again, other), _ = root.ask("prepared")
    assert process == again
    assert len({process, copy, other, os.getpid()}) == 4
    assert root.ask("fails to prepare")[0] == "as it is"


def test_a_state_is_reached_once_and_can_be_asked_later(root):
    (steps, process), two = root.ask(2, key="two")
    again, also_two = root.ask(2, key="two")
    assert (steps, process) == again
    for waiting in (two, also_two):
        assert waiting.ask("state")[0][0] == 2
    (five, _), _ = two.ask(3, key="three")
    assert five == 5
    assert root.ask("state")[0][0] == 0
    assert root.ask(4, key="four")[0][0] == 4


def test_copies_of_the_asking_process_ask_too(root):
    """A run is a copy that ends; what it has reached stays for the next one."""
    read, write = os.pipe()
    if not (child := os.fork()):
        os.write(write, str(root.ask(7, key="seven")[0]).encode())
        os._exit(0)
    os.waitpid(child, 0)
    said = os.read(read, 100).decode()
    assert said == str(root.ask(7, key="seven")[0])


@pytest.mark.parametrize("key", [None, "kept"])
def test_what_goes_wrong_is_an_error_and_the_process_waits_on(root, key):
    with pytest.raises(FrozenError, match="no such question"):
        root.ask("fails", key)
    with pytest.raises(FrozenError, match=r"died|no answer"):
        root.ask("dies", None if key is None else "dead")
    assert root.ask("state")[0][0] == 0


def test_an_answer_that_does_not_come_is_an_error(root):
    with pytest.raises(FrozenError, match="no answer"):
        root.ask("hangs", limit=0.5)
    assert root.ask("state")[0][0] == 0


def test_large_answers_come_whole(root):
    assert root.ask("large")[0] == "x" * 5_000_000


def test_they_end_when_nobody_can_ask_any_more(root):
    (_, process), waiting = root.ask(1, key="one")
    waiting._door.close()
    root._door.close()
    for _ in range(100):
        if not alive(process):
            return
        time.sleep(0.1)
    pytest.fail("the process still waits")


def test_a_killed_process_gives_no_answer(root):
    (_, process), waiting = root.ask(1, key="one")
    os.kill(process, signal.SIGKILL)
    with pytest.raises(FrozenError):
        waiting.ask("state")


def alive(process: int) -> bool:
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
