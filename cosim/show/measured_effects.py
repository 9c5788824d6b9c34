"""What an edge, or a vehicle, really did to a driven vehicle: the drive is repeated in branches without it.

An explanation says from a recorded drive what a reason did (`cosim.show.action_effects`): the policy decides again
without it, and all other vehicles move as recorded. Here the traffic of the run is simulated again, and every start is
driven again from the take-over on: as it was, without each single edge, and without each vehicle, that is without all
edges from it. In a branch everybody reacts to everything. So the stated effect can be compared with the measured one,
and the named cause with the vehicle whose absence changes most. Begin with `measured_effects`.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from cosim.loop.driving import Driver, drive, start_round
from cosim.loop.intervention import NoIntervention
from cosim.loop.round_recorder import Round
from cosim.loop.trunk import Trunk
from cosim.loop.vehicles_ahead import SpeedRecord
from cosim.measures.statistics import Estimate, mean, share
from cosim.process.fork import CAN_FORK, fork
from cosim.runs.policy_loading import driver_of
from cosim.show.action_effects import drive_of, effect_of_vehicle, effect_since_takeover
from cosim.show.episode_view import EpisodeView, episode_view
from cosim.spec.input_files import find_net
from cosim.spec.scenario import CarFollowing, Scenario
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.scratch_files import scratch_files
from cosim.traffic.simulation_input import prepare_simulation
from cosim.traffic.warm_up import warm_up
from cosim.world.episode import Episode
from cosim.world.groups import isolated
from cosim.world.snapshot import Snapshot
from gri.errors import InputError
from gri.networks.next_ahead import FollowsNextAhead
from gri.table import Table

SMALL = 0.05  # [m/s²]; a smaller effect is none
SAME = 1e-6  # [m/s], the largest difference between a recorded speed and the one of the repeated drive
Edges = frozenset[tuple[int, int]]
Speeds = Float[np.ndarray, "G T N"]


@dataclass(frozen=True)
class _Repeated:
    """The speeds [m/s] of the groups of a round from the take-over on, and when [s] each drive or its group ended."""

    speed: Speeds
    end: Float[np.ndarray, " G"]


def measured_effects(
    scenario: Scenario,
    tables: Mapping[str, pd.DataFrame],
    over: float,
    tell: Callable[[str, int, int], None],
    scratch: Path | None = None,
) -> pd.DataFrame:
    """One row per episode of a run, driven vehicle and other vehicle of its group.

    Columns: `episode`, `receiver`, `sender`, `edge` (inferred at the take-over), `over` [s] (less where a drive ended
    before, or another vehicle joined), `stated` (what the explanation says the edge, or being seen ahead, did to the
    acceleration, on average over that time), `stated_vehicle` (the same of the whole vehicle, also by way of others
    that the policy drives), and `without_edge`, `without_vehicle` (what was measured); all effects in m/s², positive
    where the reason made the vehicle faster. `same` says whether the repeated drive has the recorded speeds.

    Args:
        scenario: the scenario of the run.
        tables: the tables of the run.
        over: time from the take-over [s].
        tell: is told about the progress.
        scratch: folder for temporary files.

    Raises:
        InputError: the policy has no graph, the run has perturbations, or the system cannot fork.
    """
    driver = driver_of(scenario)
    if driver is None or not len(tables["graphs"]):
        raise InputError("--measure: the policy of this run infers no graph, so its explanations name no edge")
    if scenario.perturbations:
        raise InputError("--measure: got a run with perturbations, wanted one without; run the scenario without them")
    if not CAN_FORK:
        raise InputError("--measure: it repeats drives in forks of the process, which this system cannot make")
    views = {(v.ids, round(v.takeover_time, 3)): v for v in _views(tables)}
    rows: list[dict[str, object]] = []
    with scratch_files(find_net(scenario.net), scratch) as files:
        inputs = prepare_simulation(scenario, files, scenario.time_limit)
        inputs.write()
        with simulation(inputs) as running:
            trunk = Trunk(running, inputs.scenario, warm_up(running.world, inputs.scenario, tell))
            done = 0
            while done < len(views) and trunk.time < inputs.end:
                tell("episodes", done, len(views))
                history = trunk.observe_history()
                found = trunk.find_groups(history, limit=len(views) - done)
                if not found.groups:
                    continue
                speeds = fork(lambda: trunk.leave_to_sumo(history, found)[1]).result()  # noqa: B023
                for groups in isolated(found.groups, history[-1]):
                    this_round = dataclasses.replace(found, groups=groups)
                    rows += _rows_of_round(running, history, this_round, speeds, driver, scenario, views, over)
                done += len(found.groups)
                trunk.leave_to_sumo(history, found)
    return pd.DataFrame(rows)


def _views(tables: Mapping[str, pd.DataFrame]) -> list[EpisodeView]:
    return [episode_view(tables, int(number)) for number in tables["groups"]["episode"]]


def _rows_of_round(
    running: RunningSimulation,
    history: Sequence[Snapshot],
    this_round: Round,
    ahead: SpeedRecord,
    driver: Driver,
    scenario: Scenario,
    views: Mapping[tuple[tuple[str, ...], float], EpisodeView],
    over: float,
) -> Iterator[dict[str, object]]:
    """The rows of the groups of one branch; vehicles ahead of them repeat the speeds of `ahead`, as in the run."""
    size, driven = this_round.size, this_round.driven_roles
    short = dataclasses.replace(this_round, driven_steps=round(over / this_round.dt), watched_steps=0)

    undisturbed = NoIntervention(short).repeating(ahead, history[-1])

    def speeds(without: Edges) -> _Repeated:
        start = start_round(running.frame, history, undisturbed, dataclasses.replace(driver, without=without))

        def go() -> _Repeated:
            episodes = drive(running.world, running.frame, start)
            kept = [episode.feature("v")[episode.time >= episode.group.time - 1e-6] for episode in episodes]
            return _Repeated(np.stack(kept), np.array([_same_until(episode) for episode in episodes]))

        return fork(go).result()

    as_it_was = speeds(frozenset())
    of_vehicle = {i: speeds(frozenset((i, j) for j in range(size) if j != i)) for i in range(size)}
    of_edge = {(i, j): speeds(frozenset({(i, j)})) for j in driven for i in range(size) if i != j}
    for g, group in enumerate(this_round.groups):
        view = views.get((group.ids, round(group.time, 3)))
        if view is None:
            continue
        recorded = view.feature("v")[view.during_drive]
        known = min(len(recorded), as_it_was.speed.shape[1])
        same = bool(np.abs(recorded[:known] - as_it_was.speed[g, :known]).max() <= SAME)
        replay = drive_of(view, scenario)
        for i, j in of_edge:
            ends = [part.end[g] for part in (as_it_was, of_vehicle[i], of_edge[i, j])]
            steps = min(round((min(ends) - group.time) / short.dt), len(replay.state) - 1)
            kind = replay.graphs[0].get((i, j)) if replay.graphs else None
            if steps < 1:
                continue

            def effect(part: _Repeated, g: int = g, j: int = j, steps: int = steps) -> float:
                return float(as_it_was.speed[g, steps, j] - part.speed[g, steps, j]) / (steps * short.dt)

            assert driver.policy is not None, "SUMO's drivers have no graph"
            unnamed = kind is None and not isinstance(driver.policy, FollowsNextAhead)
            stated = 0.0 if unnamed else effect_since_takeover(replay, driver.policy, i, j, steps)
            stated_vehicle = float(effect_of_vehicle(replay, driver.policy, i, driven, steps)[j])
            yield {
                "episode": view.number,
                "receiver": j,
                "sender": i,
                "edge": "none" if kind is None else kind.value,
                "over": steps * short.dt,
                "stated": stated,
                "stated_vehicle": stated_vehicle,
                "without_edge": effect(of_edge[i, j]),
                "without_vehicle": effect(of_vehicle[i]),
                "same": same,
            }


def _same_until(episode: Episode) -> float:
    """When [s] a drive ends, or another vehicle has a role in it."""
    return min(episode.end, float(episode.time[episode.unchanged][-1]))


@dataclass(frozen=True)
class Faithfulness:
    """How many explanations name the vehicle whose absence changes most, beside trivial ones; and how far off they are.

    The named cause is the vehicle with the largest stated effect, by way of others included.

    `explained` are driven vehicles for which an effect of at least SMALL is stated. `error` [m/s²] is the mean absolute
    difference between the stated effect of their cause and the measured one.
    """

    vehicles: int
    explained: int
    named: Estimate
    vehicle_ahead: Estimate
    random: Estimate
    error: Estimate
    size: Estimate


def faithfulness(rows: pd.DataFrame, in_lane: bool, clusters: str = "episode") -> Faithfulness:
    """The named cause of each driven vehicle against its largest measured effect; `clusters` is a column.

    The trivial explanations name always the vehicle ahead (in a merge the one to be followed or to yield to), or one of
    the others at random.
    """
    named, ahead, chance, error, largest, clustered, vehicles = [], [], [], [], [], [], 0
    for _, part in rows.groupby([clusters, "receiver"]):
        vehicles, receiver = vehicles + 1, int(part["receiver"].iloc[0])
        stated, measured = part["stated_vehicle"].abs().to_numpy(), part["without_vehicle"].abs().to_numpy()
        if stated.max() < SMALL:
            continue
        cause, truth = int(stated.argmax()), int(measured.argmax())
        senders = part["sender"].to_numpy()
        real = measured.max() >= SMALL
        named.append(real and cause == truth)
        next_ahead = receiver + 1 if in_lane else {0: 2, 1: 0}[receiver]
        ahead.append(real and senders[truth] == next_ahead)
        chance.append(real / len(part))
        error.append(abs(part["stated_vehicle"].iloc[cause] - part["without_vehicle"].iloc[cause]))
        largest.append(float(measured.max()))
        clustered.append(part[clusters].iloc[0])
    which = np.array(clustered)
    return Faithfulness(
        vehicles=vehicles,
        explained=len(named),
        named=share(np.array(named, dtype=bool), which),
        vehicle_ahead=share(np.array(ahead, dtype=bool), which),
        random=mean(np.array(chance, dtype=float), which),
        error=mean(np.array(error, dtype=float), which),
        size=mean(np.array(largest, dtype=float), which),
    )


def faithfulness_table(found: Faithfulness, over: float) -> Table:
    """The table that `cosim explain --measure` prints."""

    def percent(value: Estimate) -> str:
        interval = "" if np.isnan(value.low) else f" [{100 * value.low:.0f}, {100 * value.high:.0f}]"
        return f"{100 * value.value:.0f}{interval}"

    lines = [
        ["the explanation", percent(found.named)],
        ["always the vehicle ahead", percent(found.vehicle_ahead)],
        ["a random member of the group", percent(found.random)],
    ]
    names = ("named", "vehicle_ahead", "random")
    records = [
        {"cause": line[0], **dataclasses.asdict(getattr(found, name))} for line, name in zip(lines, names, strict=True)
    ]
    note = (
        f"{found.explained} of {found.vehicles} driven vehicles have a stated effect of at least {SMALL:g} m/s² over"
        f" {over:g} s; the others have no cause to name. Stated and measured effect of the named cause differ by"
        f" {found.error.value:.2f} m/s² on average; the largest effects are {found.size.value:.2f} m/s²."
    )
    return Table("faithfulness", ["named cause", "is the largest measured effect [%]"], lines, records, note=note)


def is_in_lane(scenario: Scenario) -> bool:
    """Whether the groups of a scenario follow in one lane."""
    return isinstance(scenario.group, CarFollowing)
