"""Everything that SUMO is started with: one value, made once, before anything runs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace

from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.spec.demand import Bottleneck
from cosim.spec.scenario import Replay, Scenario
from cosim.spec.sumo_configuration import configuration
from cosim.spec.work import refuse_too_much
from cosim.traffic.additional_file import without_outputs
from cosim.traffic.recorded_track import RecordedTrack
from cosim.traffic.replay import without_demand
from cosim.traffic.route_file import arguments, route_file, sign_file
from gri.errors import InputError


@dataclass(frozen=True)
class SumoFiles:
    """Paths of the files that SUMO reads and writes: the net, the route file and the log of its messages."""

    net: Path
    routes: Path
    log: Path

    @property
    def signs(self) -> Path:
        """Path of the file of variable speed signs, beside the route file."""
        return self.routes.with_suffix(".signs.xml")


@dataclass(frozen=True)
class SimulationInput:
    """What SUMO is started with.

    `scenario` is the scenario as it is simulated: where a recording is replayed, its traffic has no demand and no
    warm-up. `texts` are the contents of the files to write, `arguments` is SUMO's command line, `tracks` are the
    recorded vehicles to replay, `friction` is the coefficient of friction for which drivers slow down before bends.
    Traffic perturbations of the scenario are in the files and the friction only, not in `scenario.traffic`.
    """

    scenario: Scenario
    files: SumoFiles
    texts: Mapping[Path, str]
    arguments: tuple[str, ...]
    tracks: tuple[RecordedTrack, ...]
    end: float
    """Time [s] until which there is traffic: the end of the demand, or of the recording where that ends earlier."""
    friction: float | None = None
    bottleneck: Bottleneck | None = None
    """The bottleneck, if its limits move while the simulation runs."""

    def write(self) -> None:
        """Write the files that SUMO reads besides the net and the user's own files."""
        for path, text in self.texts.items():
            path.write_text(text, encoding="utf-8")


def prepare_simulation(scenario: Scenario, files: SumoFiles, duration: float) -> SimulationInput:
    """Make the input of a simulation that lasts the warm-up and `duration` [s] more; nothing is written or started.

    Raises InputError where the recording to replay is missing or lacks a column, or the work is too much.
    """
    try:
        refuse_too_much(scenario.work(duration), scenario.max_work)
    except ValueError as error:
        raise InputError(str(error)) from None
    tracks: tuple[RecordedTrack, ...] = ()
    end_of_recording = math.inf
    if isinstance(scenario.background, Replay):
        from cosim.traffic.recorded_tracks import read_tracks

        tracks = read_tracks(scenario.background, scenario.step)
        end_of_recording = max((track.last_step for track in tracks), default=0) * scenario.step
        scenario = replace(scenario, traffic=without_demand(scenario.traffic))
    if scenario.traffic.has_own_files:
        return _with_own_files(scenario, files, duration)
    end_of_demand = scenario.traffic.warm_up + duration
    traffic = perturbed_traffic(scenario).traffic
    paths = (str(path) for path in (files.net, files.routes, files.signs, files.log))
    return SimulationInput(
        scenario=scenario,
        files=files,
        texts={files.routes: route_file(traffic, scenario.seed, end_of_demand), files.signs: sign_file(traffic)},
        arguments=tuple(arguments(scenario, *paths)),
        tracks=tracks,
        end=min(end_of_demand, end_of_recording),
        friction=traffic.friction,
        bottleneck=traffic.bottleneck if traffic.bottleneck is not None and traffic.bottleneck.moves else None,
    )


def _with_own_files(scenario: Scenario, files: SumoFiles, duration: float) -> SimulationInput:
    """The input with SUMO files of the user; additional files that would write output are replaced by copies."""
    given = configuration(scenario.traffic)
    copies = {path: without_outputs(path) for path in given.additional}
    written = {
        files.routes.with_name(f"additional.{k}.add.xml"): text for k, text in enumerate(copies.values()) if text
    }
    unwritten = [path for path, text in copies.items() if not text]
    end = given.begin + scenario.traffic.warm_up + duration
    return SimulationInput(
        scenario=scenario,
        files=files,
        texts=written,
        arguments=tuple(
            arguments(
                scenario,
                str(files.net),
                ",".join(map(str, given.routes)),
                ",".join(map(str, [*unwritten, *written])),
                str(files.log),
            )
        ),
        tracks=(),
        friction=scenario.traffic.friction,
        end=end if given.end is None else min(end, given.end),
    )
