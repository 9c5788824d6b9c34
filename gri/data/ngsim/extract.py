"""Extracting scenes from NGSIM files into a scene file."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, Literal, Protocol

import msgspec
import numpy as np

from gri.data.ngsim import sampled_lateral_motion
from gri.data.ngsim.car_following import car_following_triples
from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import Quality, clean
from gri.data.ngsim.lane_changing import HYPOTHESISED_GRAPHS, Hypothesis, lane_change_groups
from gri.data.ngsim.recordings import Recording, store_recordings
from gri.data.ngsim.rules import FREEWAYS, Rules, splits_of
from gri.data.ngsim.smoothing import Motion, smoothed
from gri.data.scene_file.schema import Header, SceneBlock, header_of, names_of, writing
from gri.errors import InputError
from gri.networks.model import CHAIN, Edge
from gri.progress import Progress, no_progress
from gri.storage.scratch import ScratchFolder

Kind = Literal["car_following", "lane_changing_h1", "lane_changing_h2"]
HYPOTHESES: dict[Kind, Hypothesis] = {"lane_changing_h1": "H1", "lane_changing_h2": "H2"}
KINDS: tuple[Kind, ...] = ("car_following", *HYPOTHESES)


@dataclass(frozen=True)
class Extracted:
    """Number of scenes extracted, and of candidates rejected."""

    scenes: Counter[tuple[str, str, str]]
    """Number of scenes by (site, kind, split)."""
    rejected: Counter[tuple[str, str]]
    """Number of rejected candidates by (kind, reason)."""
    reports: tuple[Quality, ...]
    """Data report of each recording."""


class CountedRecordings(Protocol):
    """Recordings, one after the other, and how many there are."""

    def __iter__(self) -> Iterator[Recording]: ...

    def __len__(self) -> int: ...


@dataclass(frozen=True)
class RecordingsDoor:
    """How files are opened that have another layout than NGSIM's (`gri.data.recordings`)."""

    open: Callable[[Path, Path], CountedRecordings]
    """From a file and a folder for temporary files to its recordings: they can be counted and iterated over."""
    provenance: dict[str, Any]
    """Goes to the header of the scene file."""


def inspect(
    path: Path, site: str | None = None, progress: Progress = no_progress
) -> tuple[list[Quality], dict[str, int]]:
    """The data report of every recording of a file, and the number of unreadable rows by site.

    `site` overrides the site that the file names. Errors: `InputError` if the file cannot be read (`store_recordings`)
    or its units are not feet and seconds (`clean`).
    """
    with ScratchFolder() as folder:
        store = store_recordings(path, Path(folder), site, progress)
        return [clean(recording)[1] for recording in store], dict(store.unreadable)


def extract(
    paths: Sequence[Path],
    out: Path,
    rules: Rules,
    kinds: Sequence[Kind] = KINDS,
    site: str | None = None,
    progress: Progress = no_progress,
    door: RecordingsDoor | None = None,
) -> Extracted:
    """Write the scenes of the files to the scene file `out`. The same files, rules and versions give the same bytes.

    `kinds` are the kinds of scenes wanted; `site` overrides the site that the files name. `door` opens files of other
    layouts; without it, they have NGSIM's.

    Errors: `InputError` if a file cannot be read, its units are not feet and seconds, or no scene obeys the rules.
    """
    scenes: Counter[tuple[str, str, str]] = Counter()
    rejected: Counter[tuple[str, str]] = Counter()
    reports: list[Quality] = []

    def extract_recording(recording: Recording, write: Callable[[SceneBlock], None]) -> None:
        """Write all scenes of one recording. A function of its own, so that its arrays are freed before the next."""
        motion, quality = _smoothed_motion(recording, rules, rejected)
        reports.append(quality)
        for kind in kinds if motion is not None else ():
            assert motion is not None
            for part in chain(
                _recorded_scenes(kind, recording, motion, rules, rejected),
                _scenes_with_sampled_lateral_motion(kind, recording, motion, rules),
            ):
                write(part)
                scenes.update((str(part.source[0]), kind, str(split)) for split in part.split)

    door = door or RecordingsDoor(
        lambda path, folder: store_recordings(path, folder, site, progress), _provenance(paths, rules, kinds, site)
    )
    with writing(out, Header(dt=rules.smoothing.dt, provenance={"made by": _program(), **door.provenance})) as write:
        for path in paths:
            with ScratchFolder() as folder:
                store = door.open(path, Path(folder))
                for done, recording in enumerate(store):
                    extract_recording(recording, write)
                    progress(f"cutting {path.name}", done + 1, len(store), float(scenes.total()))
        if not scenes:
            found = ", ".join(f"{count} × {reason}" for (_, reason), count in rejected.most_common(3) if count)
            raise InputError(
                f"{', '.join(map(str, paths))}: no scene obeys the rules ({found or 'no candidates'}); see"
                " `gri scenes inspect`"
            )
    return Extracted(scenes, rejected, tuple(reports))


def scene_file(source: Path, folder: Path, progress: Progress = no_progress) -> Path:
    """The path of a scene file: `source` itself, or one extracted from NGSIM files.

    `source` may be a scene file, an NGSIM file, or a folder of NGSIM files. A newly extracted file is kept in `folder`
    under a name that depends on the files and the rules. Errors: `InputError` if `source` is none of these.
    """
    if source.suffix == ".parquet":
        header_of(source)
        return source
    found = [source] if source.is_file() else sorted(source.glob("*"))
    files = [p for p in found if p.name.lower().endswith((".txt", ".csv", ".gz", ".zip"))]
    if not files:
        raise InputError(f"{source}: got no NGSIM files (.txt, .csv, .gz, .zip) and no scene file; give either")
    key = msgspec.json.encode(
        [[(p.name, p.stat().st_size) for p in files], Rules(), sampled_lateral_motion.LANE_OFFSET_STD]
    )
    path = folder / f"ngsim-{hashlib.sha256(key).hexdigest()[:10]}.parquet"
    if not path.is_file():
        extract(files, path, Rules(), progress=progress)
    return path


def _smoothed_motion(
    recording: Recording, rules: Rules, rejected: Counter[tuple[str, str]]
) -> tuple[Motion | None, Quality]:
    tracks, quality = clean(recording)
    if recording.site not in FREEWAYS and recording.site in ("lankershim", "peachtree"):
        rejected["all", f"recording of {recording.site}, a city street"] += 1
        return None, quality
    return smoothed(tracks, rules.smoothing), quality


def _recorded_scenes(
    kind: Kind, recording: Recording, motion: Motion, rules: Rules, rejected: Counter[tuple[str, str]]
) -> Iterator[SceneBlock]:
    """The recorded scenes of a kind."""
    counts: Counter[str] = Counter()
    if hypothesis := HYPOTHESES.get(kind):
        rows, graph = lane_change_groups(motion, rules, hypothesis, counts), HYPOTHESISED_GRAPHS[hypothesis]
    else:
        rows, graph = car_following_triples(motion, rules, counts), CHAIN
    rejected.update({(kind, reason): count for reason, count in counts.items()})
    for batch in _batches(rows):
        yield _block(kind, recording, motion, batch, graph, rules)


def _scenes_with_sampled_lateral_motion(
    kind: Kind, recording: Recording, motion: Motion, rules: Rules
) -> Iterator[SceneBlock]:
    """Lane changes with sampled lateral motion, of vehicles that are not for testing (`sampled_lateral_motion`)."""
    hypothesis = HYPOTHESES.get(kind)
    if hypothesis is None:
        return
    rows = car_following_triples(
        motion, msgspec.structs.replace(rules, following_steps=rules.changing_steps), Counter()
    )
    rows = rows[splits_of(motion.vehicle[rows[:, 0, 0]], rules) != "test"][
        :, list(sampled_lateral_motion.VEHICLE_ORDER[hypothesis])
    ]
    generator = np.random.default_rng([rules.seed, recording.clock % 2**32, int(hypothesis[1])])
    for _ in range(rules.drawn):
        for batch in _batches(rows):
            block = _block(kind, recording, motion, batch, HYPOTHESISED_GRAPHS[hypothesis], rules, ("x",))
            lateral = sampled_lateral_motion.sample_lateral_motion(
                len(batch), rules.changing_steps, rules.smoothing.dt, rules.crossing, generator
            )
            source = np.full(len(batch), recording.site + sampled_lateral_motion.SOURCE_SUFFIX, object)
            lateral_features = {name: values.astype(np.float32) for name, values in lateral.items()}
            yield replace(block, source=source, features={**block.features, **lateral_features})


SCENES_PER_BLOCK = 10_000
"""Scenes held in memory at once; a recording period has a hundred thousand."""


def _batches(rows: np.ndarray) -> Iterator[np.ndarray]:
    """The rows [S, 3, T] in parts of up to `SCENES_PER_BLOCK` scenes."""
    return (rows[start : start + SCENES_PER_BLOCK] for start in range(0, len(rows), SCENES_PER_BLOCK))


def _block(
    kind: Kind,
    recording: Recording,
    motion: Motion,
    rows: np.ndarray,
    graph: tuple[Edge, ...],
    rules: Rules,
    axes: Sequence[str] = ("x", "y"),
) -> SceneBlock:
    """Scenes of the rows [S, 3, T] in single precision, as in the file, with the recorded motion along `axes`."""
    recorded = [axis for axis in axes if axis == "x" or (len(motion) and np.ptp(motion.y) > 0)]
    names = [before + axis for axis in recorded for before in ("", "v", "a")]
    features = {name: getattr(motion, name).astype(np.float32)[rows] for name in names}
    features |= {"v": features["vx"], "a": features["ax"]}  # along the road, as headings were not recorded
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


def _provenance(paths: Sequence[Path], rules: Rules, kinds: Sequence[Kind], site: str | None) -> dict[str, Any]:
    files = [{"name": path.name, "sha256": _sha256(path)} for path in paths]
    return {"ngsim": {"files": files, "rules": msgspec.to_builtins(rules), "kinds": list(kinds), "site": site}}


def _program() -> str:
    return f"gri-cosim {version('gri-cosim')}"


def _sha256(path: Path) -> str:
    if not path.is_file():
        raise InputError(f"{path}: no such file; give NGSIM trajectory files (.txt, .csv, .gz or .zip)")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
