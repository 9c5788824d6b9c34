"""Names of files with letters outside ASCII: SUMO reads them in the character set of the process's locale."""

import locale
import sys
from contextlib import suppress


def use_utf8_paths() -> None:
    """Let SUMO read names of files as UTF-8 where Python does so although the locale says otherwise, as LC_ALL=C."""
    if sys.getfilesystemencoding() != "utf-8" or not hasattr(locale, "nl_langinfo"):
        return
    if locale.nl_langinfo(locale.CODESET).upper().replace("-", "") == "UTF8":
        return
    for name in ("C.UTF-8", "en_US.UTF-8"):
        with suppress(locale.Error):
            locale.setlocale(locale.LC_CTYPE, name)
            return
