"""A process that waits in the state in which it was made, its simulation included, and answers questions in copies.

Any copy of the process that made it may ask, now or later. A question with a key is answered once: the answer is kept,
and the copy that gave it may wait as a frozen process in turn, in the state that it has reached. So a tree of states
grows from one process, and each state is reached once, whoever asks for it.
"""

import gc
import os
import pickle
import socket
import struct
import traceback
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass
from select import select
from typing import Any

from cosim.process.failures import exit_cause
from cosim.process.fork import LIMIT, PARENT_CHECKED_EVERY, plain_fork

_HEAD = "<?Q"  # whether another frozen process comes with an answer, and the length of the answer


@dataclass(frozen=True)
class Handler:
    """What answers questions to a frozen process.

    `answer` is called in a copy of the process. It returns the answer, and what answers questions to the copy
    afterwards; None where the copy ends. `prepare` turns a question without a key into what `answer` gets, in the
    process itself and so in less time: a copy pays for each page of memory that it touches. Where it fails, `answer`
    gets the question as it is.
    """

    answer: Callable[[Any], tuple[Any, "Handler | None"]]
    prepare: Callable[[Any], Any] = lambda question: question


class FrozenError(RuntimeError):
    """There is no answer: the handler raised an exception, or a process died."""


@dataclass(frozen=True)
class FrozenProcess:
    """The way to a frozen process. It ends when nobody has a way to it any more, and with the process that made it."""

    _door: socket.socket

    def __del__(self) -> None:
        self._door.close()

    def ask(self, question: Any, key: Hashable = None, limit: float = LIMIT) -> tuple[Any, "FrozenProcess | None"]:
        """The answer to a question (both must be picklable), and the process that has reached the state behind it.

        Raises `FrozenError` if there is none, also after `limit` [s].
        """
        ours, theirs = socket.socketpair()
        with ours:
            ours.settimeout(limit)
            try:
                with theirs:
                    socket.send_fds(self._door, [b"?"], [theirs.fileno()])
                _send(ours, pickle.dumps((key, question)))
                (failed, value), door = _answer(ours)
            except (OSError, EOFError) as error:
                raise FrozenError(f"a frozen process gave no answer ({type(error).__name__})") from error
        if failed:
            raise FrozenError(value)
        return value, None if door is None else FrozenProcess(door)


def freeze(handler: Handler) -> FrozenProcess:
    """A copy of this process that waits as it is now, and answers questions by the handler."""
    ours, theirs = socket.socketpair()
    if plain_fork():
        theirs.close()
        return FrozenProcess(ours)
    try:
        ours.close()
        _serve(theirs, handler)
    finally:
        os._exit(0)


def _serve(door: socket.socket, handler: Handler) -> None:
    """Answer questions until nobody can ask any more."""
    gc.freeze()  # what there is now need not be looked through again, and copied for that, in every copy
    original, known = os.getppid(), {}
    while True:
        while not select([door], [], [], PARENT_CHECKED_EVERY)[0]:
            if os.getppid() != original:
                return
        _, descriptors, *_ = socket.recv_fds(door, 1, 1)
        if not descriptors:
            return
        with suppress(OSError, EOFError), socket.socket(fileno=descriptors[0]) as asker:
            key, question = pickle.loads(_received(asker))
            if key is None:
                _answer_in_copy(asker, handler, question)
            else:
                if key not in known:
                    known[key] = _reached(handler, question, [door, asker, *(way for _, way in known.values() if way)])
                answer, way = known[key]
                if not answer:
                    del known[key]
                    answer = pickle.dumps((True, "a frozen process died while it answered"))
                _send(asker, answer, way)
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


def _answer_in_copy(asker: socket.socket, handler: Handler, question: Any) -> None:
    """Let a copy answer, and go on without waiting for it."""
    with suppress(Exception):
        question = handler.prepare(question)
    if plain_fork():
        return
    try:
        _send(asker, _outcome(handler, question)[0])
    finally:
        os._exit(0)


def _reached(handler: Handler, question: Any, unused: list[socket.socket]) -> tuple[bytes, socket.socket | None]:
    """The answer of a copy, and the way to it where it waits in turn. The copy closes what is `unused`."""
    ours, theirs = socket.socketpair()
    read, write = os.pipe()
    pid = plain_fork()
    if not pid:
        try:
            for connection in (ours, *unused):
                connection.close()
            os.close(read)
            answer, following = _outcome(handler, question)
            with os.fdopen(write, "wb") as stream:
                stream.write(pickle.dumps((answer, following is not None)))
            if following is not None:
                _serve(theirs, following)
        finally:
            os._exit(0)
    theirs.close()
    os.close(write)
    with os.fdopen(read, "rb") as stream:
        content = stream.read()
    answer, waits = pickle.loads(content) if content else (b"", False)
    if not waits:
        ours.close()
        status = os.waitpid(pid, 0)[1]
        if not answer:
            cause = exit_cause(os.waitstatus_to_exitcode(status))
            answer = pickle.dumps((True, f"a frozen process died while it answered ({cause})"))
    return answer, ours if waits else None


def _outcome(handler: Handler, question: Any) -> tuple[bytes, Handler | None]:
    """What the handler returned or raised, pickled."""
    try:
        value, following = handler.answer(question)
        return pickle.dumps((False, value)), following
    except BaseException:
        return pickle.dumps((True, traceback.format_exc())), None


def _send(connection: socket.socket, content: bytes, way: socket.socket | None = None) -> None:
    head = struct.pack(_HEAD, way is not None, len(content))
    if way is None:
        connection.sendall(head)
    else:
        socket.send_fds(connection, [head], [way.fileno()])
    connection.sendall(content)


def _received(connection: socket.socket) -> bytes:
    _, size = struct.unpack(_HEAD, _exactly(connection, struct.calcsize(_HEAD)))
    return _exactly(connection, size)


def _answer(connection: socket.socket) -> tuple[Any, socket.socket | None]:
    head, descriptors, *_ = socket.recv_fds(connection, struct.calcsize(_HEAD), 1)
    if not head:
        raise EOFError
    _, size = struct.unpack(_HEAD, head)
    return pickle.loads(_exactly(connection, size)), socket.socket(fileno=descriptors[0]) if descriptors else None


def _exactly(connection: socket.socket, size: int) -> bytes:
    content = bytearray()
    while len(content) < size:
        part = connection.recv(min(size - len(content), 2**20))
        if not part:
            raise EOFError
        content += part
    return bytes(content)
