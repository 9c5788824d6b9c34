"""A finished run with its tables: `open_run` reads it from its folder."""

from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

from cosim.perturb.effects import COLUMNS as EFFECT_COLUMNS
from cosim.runs.finished_run import read_group_manifest
from cosim.runs.run_reading import TABLES, read_tables
from cosim.runs.summary import summary
from cosim.runs.surroundings_table import read_surroundings
from cosim.world.backlog import MANY_WAITING
from cosim.world.episode import EventKind
from cosim.world.group_search import why_not_more
from cosim.world.outcome_columns import group_size
from gri.errors import InputError


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

    @property
    def releases(self) -> pd.DataFrame:
        """Recorded vehicles that were released to car following: episode, time, vehicle, and `after` the take-over [s].

        No rows unless the scenario replays a recording with `react`.
        """
        events = self.events[(self.events["kind"] == EventKind.RELEASED.value) & ~self.events["counterpart"]]
        begin = self.groups.set_index("episode")["takeover_time"]
        found = events[["episode", "time", "vehicles"]].rename(columns={"vehicles": "vehicle"})
        return found.assign(after=found["time"] - found["episode"].map(begin)).reset_index(drop=True)

    def notes(self) -> list[str]:
        """What the summary does not say: how many recorded vehicles were released, and when."""
        released = self.releases
        if not len(released):
            return []
        return [
            f"{len(released)} recorded vehicles behind driven ones were released to car following, in"
            f" {released['episode'].nunique()} of {len(self.groups)} groups, {released['after'].min():.1f} to"
            f" {released['after'].max():.1f} s after the take-over (table events)"
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
                " (of files of your own: traffic.options, scale: 0.8)"
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


def open_run(folder: str | Path) -> Run:
    """Read a finished run from its folder.

    Raises:
        InputError: the folder is no run folder, or a file in it is not what the run wrote.
    """
    folder = Path(folder)
    return Run(folder, **read_tables(folder), manifest=read_group_manifest(folder))
