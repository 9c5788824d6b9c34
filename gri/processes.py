"""A command that is stopped ends everything it has started; a worker whose command was killed ends, too.

A command calls `stop_like_ctrl_c` once, a worker process `end_with_parent`.
"""

import os
import signal
import threading
from multiprocessing import parent_process
from multiprocessing.process import BaseProcess


def stop_like_ctrl_c() -> None:
    """Let the signal to terminate, and that of a closed terminal, do what Ctrl-C does: `KeyboardInterrupt`.

    By default they end a process at once, and nobody ends its workers. A signal that is ignored, as under `nohup`,
    stays ignored.
    """
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


def end_with_parent(group: bool = False) -> None:
    """End this worker of `multiprocessing` as soon as the process that started it has ended, also by SIGKILL.

    With `group`, it becomes the leader of a group of processes, and all of the group end.
    """
    if group and hasattr(os, "setsid"):
        os.setsid()
    parent = parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        if group and hasattr(os, "killpg"):
            os.killpg(0, signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=wait, name="end_with_parent", daemon=True).start()


def end_group(process: BaseProcess, number: int = signal.SIGTERM) -> None:
    """Send a signal to a worker and, where it leads a group of processes, to all of them."""
    try:
        os.killpg(process.pid or 0, number)
    except (AttributeError, OSError):  # no group yet or any more, or a system without groups
        process.terminate() if number == signal.SIGTERM else process.kill()
