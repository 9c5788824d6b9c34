"""The layouts that can be read, and which of them a file has.

A file is recognised by its columns, never by its name alone. What differs between files of one layout (which lane is
the leftmost, which point of a vehicle a position refers to) is in the layout's module.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq

from gri.data.ngsim.columns import OFFICIAL_COLUMNS
from gri.data.recordings import exid, highd, i24, interaction, run_folder, sumo_fcd, tgsim, tidy
from gri.data.recordings.files import Member
from gri.data.recordings.names import plain
from gri.data.recordings.parts import Part, ReadingOptions
from gri.data.recordings.text_tables import dialect
from gri.errors import InputError

Read = Callable[[Sequence[Member], ReadingOptions, list[str]], Iterator[Part]]


@dataclass(frozen=True)
class Layout:
    """A layout: its name, what it is, the columns by which it is recognised, and the function that reads it."""

    name: str
    title: str
    columns: frozenset[str]
    """Columns by `names.plain` that no other layout has together."""
    read: Read | None
    """None: NGSIM, which is streamed (`gri.data.ngsim.recordings`)."""


LAYOUTS = (
    Layout("ngsim", "NGSIM (FHWA)", frozenset({"vehicleid", "frameid", "globaltime", "localy"}), None),
    Layout("highd", "highD (ika)", frozenset({"frame", "id", "xvelocity", "laneid", "height"}), highd.read),
    Layout("exid", "exiD, inD, rounD, uniD (ika)", frozenset({"trackid", "frame", "xcenter", "ycenter"}), exid.read),
    Layout(
        "interaction", "INTERACTION", frozenset({"trackid", "frameid", "timestampms", "agenttype"}), interaction.read
    ),
    Layout("tgsim", "TGSIM (FHWA)", frozenset({"id", "time", "xlockf", "ylockf"}), tgsim.read),
    Layout("i24", "I-24 MOTION, JSON", frozenset({"{json}"}), i24.read),
    Layout("sumo_fcd", "SUMO's FCD output: XML, CSV, Parquet", frozenset({"timesteptime", "vehicleid"}), sumo_fcd.read),
    Layout("run", "run folder of cosim", frozenset({"episode", "counterpart", "vehicle", "s", "d"}), run_folder.read),
    Layout("tidy", "tidy table", frozenset({"times", "vehicleid"}), tidy.read),
)
NAMES = tuple(layout.name for layout in LAYOUTS)
_META = ("tracksMeta", "recordingMeta", "_landmarks", "pedestrian_tracks", "README")  # files beside the tracks


def find_layout(path: Path, inside: Sequence[Member], options: ReadingOptions) -> tuple[Layout, Sequence[Member]]:
    """The layout of a path, and its files in that layout: those of the layout of the first file that has a known one.

    Errors: `InputError` if no file has a known layout.
    """
    by_name = {layout.name: layout for layout in LAYOUTS}
    if options.layout is not None:
        if options.layout not in by_name:
            raise InputError(f"--layout: got {options.layout}, wanted one of {', '.join(NAMES)}")
        return by_name[options.layout], inside
    if options.columns:
        return by_name["tidy"], inside
    if len(inside) > 1 and any(member.name in run_folder.FILES for member in inside):
        return by_name["run"], inside
    seen: dict[str, tuple[str, ...]] = {}
    found: dict[str, list[Member]] = {}
    for member in inside:
        if len(inside) > 1 and any(word in member.name for word in _META):
            continue
        columns = columns_of(member)
        names = {plain(name) for name in columns}
        if known := next((layout for layout in LAYOUTS if layout.columns <= names), None):
            found.setdefault(known.name, []).append(member)
        seen[str(member)] = columns
    for name, chosen in found.items():
        return by_name[name], chosen
    first = list(seen.items())[:2]
    shown = "; ".join(f"{name} has {', '.join(columns[:8]) or 'no columns'}" for name, columns in first)
    raise InputError(
        f"{path}: not a known layout: {shown}; give --layout ({', '.join(NAMES)}), or name the columns of the tidy"
        " table: --map time_s=COLUMN --map vehicle_id=COLUMN --map s_m=COLUMN --map lane=COLUMN"
    )


def columns_of(member: Member) -> tuple[str, ...]:
    """The columns of a file: of a text table, of Parquet, or `{json}`, or those of SUMO's FCD output in XML."""
    with member.open() as stream:
        start = stream.read(4096)
    if start[:4] == b"PAR1":
        with member.open_whole("Parquet file", "write it again") as stream:
            return tuple(pq.read_schema(stream).names)
    text = start.lstrip(b"\xef\xbb\xbf \t\r\n")
    if text[:1] == b"[" or (text[:1] == b"{" and b'"x_position"' in start):
        return ("{json}",)
    if text[:1] == b"<":
        return ("timestep_time", "vehicle_id") if b"<fcd-export" in start else ("<xml>",)
    found = dialect(member).columns
    whole = all(cell.replace(".", "").replace("-", "").replace("e+", "").isdigit() for cell in found)
    return OFFICIAL_COLUMNS if whole and len(found) == len(OFFICIAL_COLUMNS) else found
