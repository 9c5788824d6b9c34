"""A command in this process, for what does not depend on a process of its own: imports cost it nothing."""

import io
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch


def in_this_process(main: Callable[[], None], *arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """What `main` prints and ends with, when it is given these arguments in that folder; 80 columns are wide."""
    words, out, errors, code = ["command", *map(str, arguments)], io.StringIO(), io.StringIO(), 0
    given = patch.object(sys, "argv", words), patch.dict(os.environ, COLUMNS="80")
    with chdir(cwd), redirect_stdout(out), redirect_stderr(errors), given[0], given[1]:
        try:
            main()
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0
    return subprocess.CompletedProcess(words, code, out.getvalue(), errors.getvalue())
