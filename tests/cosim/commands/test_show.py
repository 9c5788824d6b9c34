"""What `cosim render` makes of its options."""

from pathlib import Path

import pytest

from cosim.commands.show import _format_of
from gri.errors import InputError


@pytest.mark.parametrize(("out", "wanted"), [(None, "html"), ("a/film.MP4", "mp4"), ("x.png", "png")])
def test_the_ending_of_the_file_says_what_it_holds(out: str | None, wanted: str):
    assert _format_of(Path(out) if out else None) == wanted


def test_an_ending_that_names_no_format_is_refused():
    with pytest.raises(InputError, match=r"got the ending '.txt', wanted one of .html, .gif, .mp4, .png"):
        _format_of(Path("episode.txt"))
