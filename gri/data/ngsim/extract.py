"""From NGSIM files to a scene file."""

import hashlib
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from gri.data.ngsim import drawn_lane_changes
from gri.data.ngsim.car_following import triples
from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import Quality, clean
from gri.data.ngsim.lane_changing import GRAPHS, Reading, groups
from gri.data.ngsim.recordings import Recording, store_recordings
from gri.data.ngsim.rules import FREEWAYS, Rules, splits_of
from gri.data.ngsim.smoothing import Motion, smoothed
from gri.data.scene_file.schema import Header, SceneBlock, header_of, names_of, writing
from gri.errors import InputError
from gri.networks.model import CHAIN, Edge
from gri.progress import Progress, no_progress

Kind = Literal["car_following", "lane_changing_h1", "lane_changing_h2"]
READINGS: dict[Kind, Reading] = {"lane_changing_h1": "H1", "lane_changing_h2": "H2"}
KINDS: tuple[Kind, ...] = ("car_following", *READINGS)


@dataclass(frozen=True)
class Extracted:
    """How many scenes came out, and why candidates were turned down."""

    scenes: Counter[tuple[str, str, str]]
    """By (site, kind, split)."""
    rejected: Counter[tuple[str, str]]
    """By (kind, reason)."""
    reports: tuple[Quality, ...]


def inspect(
    path: Path, site: str | None = None, progress: Progress = no_progress
) -> tuple[list[Quality], dict[str, int]]:
    """The data report of every recording of a file, and how many rows of each site could not be read."""
    with tempfile.TemporaryDirectory(prefix="gri-ngsim-") as folder:
        store = store_recordings(path, Path(folder), site, progress)
        return [clean(recording)[1] for recording in store], dict(store.unreadable)


def extract(
    paths: Sequence[Path],
    out: Path,
    rules: Rules,
    kinds: Sequence[Kind] = KINDS,
    site: str | None = None,
    progress: Progress = no_progress,
) -> Extracted:
    """Write all scenes of the files; the same files, rules and versions give the same bytes."""
    scenes: Counter[tuple[str, str, str]] = Counter()
    rejected: Counter[tuple[str, str]] = Counter()
    reports: list[Quality] = []

    def cut(recording: Recording, write: Callable[[SceneBlock], None]) -> None:
        """All scenes of one recording; nothing of it stays in memory for the next."""
        motion, quality = _motion(recording, rules, rejected)
        reports.append(quality)
        for kind in kinds if motion is not None else ():
            assert motion is not None
            for part in chain(
                _scenes(kind, recording, motion, rules, rejected), _drawn(kind, recording, motion, rules)
            ):
                write(part)
                scenes.update((str(part.source[0]), kind, str(split)) for split in part.split)

    with writing(out, _header(paths, rules, kinds, site)) as write:
        for path in paths:
            with tempfile.TemporaryDirectory(prefix="gri-ngsim-") as folder:
                store = store_recordings(path, Path(folder), site, progress)
                for done, recording in enumerate(store):
                    cut(recording, write)
                    progress(f"cutting {path.name}", done + 1, len(store.keys), float(scenes.total()))
        if not scenes:
            raise InputError(f"{', '.join(map(str, paths))}: no scene keeps the rules; see `gri ngsim inspect`")
    return Extracted(scenes, rejected, tuple(reports))


def scene_file(source: Path, folder: Path, progress: Progress = no_progress) -> Path:
    """A scene file as it is, or the one cut from an NGSIM file or a folder of them, kept under a name that says the
    rules. Errors: `InputError` where there is neither.
    """
    if source.suffix == ".parquet":
        header_of(source)
        return source
    found = [source] if source.is_file() else sorted(source.glob("*"))
    files = [p for p in found if p.name.lower().endswith((".txt", ".csv", ".gz", ".zip"))]
    if not files:
        raise InputError(f"{source}: got no NGSIM files (.txt, .csv, .gz, .zip) and no scene file; give either")
    key = msgspec.json.encode([[(p.name, p.stat().st_size) for p in files], Rules(), drawn_lane_changes.OFFSET])
    path = folder / f"ngsim-{hashlib.sha256(key).hexdigest()[:10]}.parquet"
    if not path.is_file():
        extract(files, path, Rules(), progress=progress)
    return path


def _motion(recording: Recording, rules: Rules, rejected: Counter[tuple[str, str]]) -> tuple[Motion | None, Quality]:
    tracks, quality = clean(recording)
    if recording.site not in FREEWAYS and recording.site in ("lankershim", "peachtree"):
        rejected["all", f"recording of {recording.site}, a city street"] += 1
        return None, quality
    return smoothed(tracks, rules.smoothing), quality


def _scenes(
    kind: Kind, recording: Recording, motion: Motion, rules: Rules, rejected: Counter[tuple[str, str]]
) -> Iterator[SceneBlock]:
    """Recorded scenes of a kind."""
    counts: Counter[str] = Counter()
    if reading := READINGS.get(kind):
        rows, graph = groups(motion, rules, reading, counts), GRAPHS[reading]
    else:
        rows, graph = triples(motion, rules, counts), CHAIN
    rejected.update({(kind, reason): count for reason, count in counts.items()})
    for some in _few(rows):
        yield _block(kind, recording, motion, some, graph, rules)


def _drawn(kind: Kind, recording: Recording, motion: Motion, rules: Rules) -> Iterator[SceneBlock]:
    """Lane changes whose lateral motion is drawn, of vehicles that are not for testing."""
    reading = READINGS.get(kind)
    if reading is None:
        return
    rows = triples(motion, msgspec.structs.replace(rules, following_steps=rules.changing_steps), Counter())
    rows = rows[splits_of(motion.vehicle[rows[:, 0, 0]], rules) != "test"][:, list(drawn_lane_changes.PLACES[reading])]
    generator = np.random.default_rng([rules.seed, recording.clock % 2**32, int(reading[1])])
    for _ in range(rules.drawn):
        for some in _few(rows):
            block = _block(kind, recording, motion, some, GRAPHS[reading], rules, ("x",))
            across = drawn_lane_changes.lateral(
                len(some), rules.changing_steps, rules.smoothing.dt, rules.crossing, generator
            )
            source = np.full(len(some), recording.site + drawn_lane_changes.MARK, object)
            single = {name: values.astype(np.float32) for name, values in across.items()}
            yield replace(block, source=source, features={**block.features, **single})


AT_ONCE = 10_000
"""Scenes held in memory: a period has a hundred thousand."""


def _few(rows: np.ndarray) -> Iterator[np.ndarray]:
    """The rows of up to `AT_ONCE` scenes at a time; nothing where there are none."""
    return (rows[start : start + AT_ONCE] for start in range(0, len(rows), AT_ONCE))


def _block(
    kind: Kind,
    recording: Recording,
    motion: Motion,
    rows: np.ndarray,
    graph: tuple[Edge, ...],
    rules: Rules,
    axes: Sequence[str] = ("x", "y"),
) -> SceneBlock:
    """Scenes of rows [S, 3, T], in single precision, as in the file."""
    recorded = [axis for axis in axes if axis == "x" or (len(motion) and np.ptp(motion.y) > 0)]
    names = [before + axis for axis in recorded for before in ("", "v", "a")]
    features = {name: getattr(motion, name).astype(np.float32)[rows] for name in names}
    features |= {"v": features["vx"], "a": features["ax"]}  # along the road: headings were not recorded
    first = int(recording.rows["frame"].min())
    vehicle = motion.vehicle[rows[:, :, 0]]
    return SceneBlock(
        kind=kind,
        source=np.full(len(rows), recording.site, object),
        recording=np.full(len(rows), recording.name, object),
        split=splits_of(vehicle[:, 0], rules),
        start=(motion.step[rows[:, 0, 0]] * rules.smoothing.every - first) * FRAME,
        vehicle=vehicle,
        features=features,
        edges=np.broadcast_to(names_of({(e.sender, e.receiver): e.type for e in graph}), (len(rows), 6)),
        size={name: getattr(motion, name)[rows[:, :, 0]] for name in ("length", "width")},
    )


def _header(paths: Sequence[Path], rules: Rules, kinds: Sequence[Kind], site: str | None) -> Header:
    files = [{"name": path.name, "sha256": _hash(path)} for path in paths]
    made = {"files": files, "rules": msgspec.to_builtins(rules), "kinds": list(kinds), "site": site}
    return Header(dt=rules.smoothing.dt, provenance={"made by": f"gri-cosim {version('gri-cosim')}", "ngsim": made})


def _hash(path: Path) -> str:
    if not path.is_file():
        raise InputError(f"{path}: no such file; give NGSIM trajectory files (.txt, .csv, .gz or .zip)")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
