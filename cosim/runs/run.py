"""The Python door to closed-loop runs: `run` runs a scenario, `open_run` reads a finished run, both return a `Run`."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd

from cosim.perturb.effects import COLUMNS as EFFECT_COLUMNS
from cosim.process.worker_process import run_in_worker
from cosim.runs.finished_run import read_group_manifest
from cosim.runs.run_folder import next_folder, run_folder
from cosim.runs.run_reading import TABLES, read_tables
from cosim.runs.summary import summary
from cosim.runs.surroundings_table import read_surroundings
from cosim.runs.user_policy import own_name, unfit
from cosim.spec.input_files import refuse_foreign_code
from cosim.spec.loading import changed, find_file, load_scenario, override, with_recording
from cosim.spec.scenario import Scenario, UserPolicy, policy_name
from cosim.spec.settings import settings_of
from cosim.world.backlog import MANY_WAITING
from cosim.world.group_search import why_not_more
from cosim.world.outcome_columns import group_size
from gri.errors import InputError
from gri.resources import checkpoints

Progress = Callable[[str, int, int], None]
"""Called with the stage of the run, the steps or episodes done in it, and their total."""

_BASELINES = ("sumo", "idm", "constant_velocity", "r157", "careful_human", "fsm", "rss")


@dataclass(frozen=True)
class Run:
    """A finished run: its folder and the tables in it (columns and units: docs/reference/run-tables.md)."""

    folder: Path
    steps: pd.DataFrame
    """One row per episode, instant and vehicle; `counterpart` marks the rows of the groups left to SUMO."""
    groups: pd.DataFrame
    """One row per driven group: the vehicles, how the drive ended, and its figures."""
    counterparts: pd.DataFrame
    """The same for the same groups left to SUMO; no rows if the policy is `sumo`. Joins `groups` by `episode`."""
    events: pd.DataFrame
    """One row per event of an episode; `counterpart` as in `steps`."""
    graphs: pd.DataFrame
    """One row per driven group, inference and ordered pair of vehicles: the inferred relation and its probability."""
    manifest: dict[str, Any]
    """Arguments, versions and hashes of the run."""

    @cached_property
    def surroundings(self) -> pd.DataFrame | None:
        """One row per episode, instant and vehicle around the group; None where the scenario left it out."""
        return read_surroundings(self.folder)

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The five tables by name."""
        return {name: getattr(self, name) for name in TABLES}

    @property
    def policy_failures(self) -> list[str]:
        """One line per group for which the policy failed: the policy, the group, the time, and what was wrong."""
        failed = self.events[self.events["kind"] == "policy_failed"].to_dict("records")
        return [
            f"{event['driver']}: group {str(event['vehicles']).replace(' ', ', ')} at t = {event['time']:.1f} s:"
            f" {event['detail']}"
            for event in failed
        ]

    def summary(self) -> pd.DataFrame:
        """The table that `cosim run` prints: a row per figure, a column per driver, all cells as text."""
        return summary(self.groups, self.counterparts, self.manifest["arguments"]["episodes"])

    @property
    def missing_episodes(self) -> int:
        """Number of episodes that the run was asked for and could not begin within its time limit."""
        arguments = self.manifest["arguments"]
        return arguments["episodes"] - arguments.get("starts", arguments["episodes"])

    def warnings(self) -> list[str]:
        """What a reader of the tables must know: too few episodes, vehicles that could not enter the road."""
        arguments, found = self.manifest["arguments"], []
        if self.missing_episodes:
            rule, seen = str(self.groups["rule"].iloc[0]), arguments["candidates_seen"]
            why = why_not_more(rule, seen, arguments["candidates_failed"], group_size(self.groups.iloc[0].to_dict()))
            found.append(
                f"{arguments['starts']} of {arguments['episodes']} episodes: the time limit was reached; raise"
                f" time_limit or loosen the group rule ({why})"
            )
        if arguments.get("waiting_outside_since") is not None:
            found.append(
                f"{arguments['waiting_outside']} vehicles wait outside the net at the end, {MANY_WAITING} or more since"
                f" {arguments['waiting_outside_since']:g} s: the road cannot take the demand; lower traffic.flows"
            )
        return found

    @property
    def effects(self) -> pd.DataFrame:
        """What each perturbation was to reach and what it reached; no rows without perturbations."""
        return pd.DataFrame(self.manifest.get("effects", []), columns=EFFECT_COLUMNS)

    def figure(self, episode: int | None = None) -> Any:
        """A matplotlib `Figure` of one episode; by default the one whose leader changes speed most.

        Raises:
            InputError: the run has no episode of that number.
        """
        from cosim.runs.episode_figure import figure

        if episode is not None and episode not in set(self.groups["episode"]):
            last = int(self.groups["episode"].max())
            raise InputError(f"episode: got {episode}, {self.folder} has the episodes 0 to {last}")
        return figure(self.tables, episode, self.folder)

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r}: {', '.join(self._facts())})"

    def _repr_html_(self) -> str:
        """The short form that notebooks show."""
        facts = " · ".join(self._facts())
        table = self.summary().replace("\n", ", ", regex=True).to_html()
        return f"<p><b>{escape(str(self.folder))}</b><br>{escape(facts)}</p>{table}"

    def _facts(self) -> list[str]:
        arguments = self.manifest["arguments"]
        return [f"driver {arguments['driver']}", f"seed {arguments['seed']}", f"{len(self.groups)} episodes"]


def run(
    scenario: str | Path | Scenario,
    policy: object | str | Path | Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    episodes: int | None = None,
    recording: str | Path | None = None,
    overrides: Mapping[str, Any] | None = None,
    settings: Sequence[str] = (),
    folder: str | Path | None = None,
    allow_code: bool = False,
    progress: Progress | None = None,
) -> Run:
    """Run a scenario in closed loop and return its tables.

    SUMO runs in a process of its own. A crash or Ctrl-C therefore ends that process only, and no half-written folder
    is left behind.

    Args:
        scenario: name of a shipped scenario, path of a YAML file, or a `Scenario`.
        policy: what drives the groups instead of the scenario's policy: "sumo", "idm", "constant_velocity", or a
            reference driver ("r157", "careful_human", "fsm", "rss"); the name or path of a checkpoint; "file.py:Name"
            or "package.module:Name" of your own policy; the mapping that a YAML file would hold; or an object that has
            the attributes of `gri.Policy`.
        seed: replaces the scenario's seed.
        episodes: replaces the scenario's number of episodes.
        recording: the recording to replay, for scenarios with a recorded background.
        overrides: other top-level fields of the scenario to replace, such as `{"horizon": 4.0}`.
        settings: changes of single fields at any depth, such as `["group.max_gap=20"]`; values are written as in YAML.
        folder: where to write the run; by default a new folder in `runs/`.
        allow_code: whether to run a policy (`kind: python`) that a scenario file names outside its own folder. Code
            that `policy` names runs in any case.
        progress: called with (stage, done, total) while the run goes on; `None` shows nothing.

    Raises:
        InputError: the scenario, the policy or the folder does not fit; the message says what to change.
        RuntimeError: the simulation failed.

    Example:
        >>> import cosim
        >>> done = cosim.run("us101_car_following", policy="idm", episodes=4)
        >>> done.groups[["driver", "ending", "min_gap"]]
        >>> done.figure()
    """
    allowed = (overrides or {}).get("max_work")
    if isinstance(scenario, Scenario):
        chosen = changed(scenario, settings_of(settings)) if settings else scenario
    else:
        chosen = load_scenario(str(scenario), max_work=allowed, settings=settings)
    spec, own = _policy(policy)
    if spec is None and isinstance(chosen.policy, UserPolicy) and not isinstance(scenario, Scenario):
        file = find_file(str(scenario), "scenarios", "scenario")
        refuse_foreign_code(msgspec.to_builtins(chosen.policy), file, allow_code)
    changes = {"seed": seed, "episodes": episodes, "policy": spec, **(overrides or {})}
    chosen = override(chosen, {name: value for name, value in changes.items() if value is not None})
    if recording is not None:
        chosen = with_recording(chosen, Path(recording))
    if chosen.has_shares:
        raise InputError("share: got a scenario with a share of the traffic and no groups; call cosim.run_traffic")
    name = chosen.net if isinstance(scenario, Scenario) else Path(scenario).stem
    driver = re.sub(r"[^\w.-]+", "-", policy_name(chosen.policy) if own is None else own_name(own))
    place = Path(folder) if folder else next_folder(Path("runs"), f"{name}-{driver}-seed{chosen.seed}")
    with run_folder(place) as partial:
        run_in_worker(
            "cosim.runs.run_job:run_job",
            chosen,
            partial,
            log=partial / "sumo.log",
            tell=progress or _no_progress,
            options={"policy": own} if own is not None else {},
        )
    return open_run(place)


def open_run(folder: str | Path) -> Run:
    """Read a finished run from its folder.

    Raises:
        InputError: the folder is no run folder, or a file in it is not what the run wrote.
    """
    folder = Path(folder)
    return Run(folder, **read_tables(folder), manifest=read_group_manifest(folder))


def _policy(policy: object) -> tuple[dict[str, Any] | None, object | None]:
    """A scenario's policy field, and the policy object if one was given instead of a description."""
    if policy is None:
        return None, None
    if isinstance(policy, Mapping):
        return dict(policy), None
    if isinstance(policy, str | Path):
        text = str(policy)
        if text.replace("-", "_") in _BASELINES:
            return {"kind": text.replace("-", "_")}, None
        if ":" in text and not Path(text).exists():
            return {"kind": "python", "object": text}, None
        if text in checkpoints() or Path(text).is_file():
            return {"kind": "gri", "checkpoint": text}, None
        raise InputError(
            f"policy: got {text!r}, expected one of {', '.join(_BASELINES)}, a checkpoint (a path, or one of"
            f" {', '.join(checkpoints())}), or 'file.py:Name'"
        )
    if problem := unfit(policy):
        raise InputError(f"policy: got {problem}; see gri.Policy")
    return {"kind": "python", "object": f"{type(policy).__module__}:{type(policy).__name__}"}, policy


def _no_progress(stage: str, done: int, total: int) -> None:
    pass
