"""How hard is the hand-back? Braking, jerk and contacts after it, beside the same groups left to SUMO.

Drives groups of the shipped scenarios by their own policy, seed after seed, and compares the seconds after the
hand-back with those of the same groups left to SUMO, after the end of their drive. One row per group goes into a CSV
file, to which a later call adds what is missing. The table in docs/hand-back.md is written from all of it.

    python benchmarks/hand_back.py
    python benchmarks/hand_back.py --scenarios us101_replay --recording us-101.csv
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import torch

from cosim.loop.closed_loop import run
from cosim.runs.policy_loading import driver_of
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario, with_recording
from cosim.spec.scenario import Scenario
from cosim.traffic.simulation_input import SumoFiles
from cosim.world.hand_back_columns import BRAKING, hand_back_columns
from gri.table import markdown_table

SCENARIOS = "us101_car_following", "i80_car_following", "us101_merge", "i80_merge", "curved_merge"
MOST_JERK = 10.0  # [m/s³] that a hand-back may have
DRIVERS = {False: "driven", True: "left alone"}
HEAD = (
    "",
    "groups",
    "≥ 2 m/s² [%]",
    "≥ 3 m/s² [%]",
    "hardest [m/s²]",
    "jerk [m/s³]",
    "jerk > 10 [%]",
    "contacts before",
    "after",
)
BEGIN, END = "<!-- figures: written by benchmarks/hand_back.py -->\n", "<!-- end of figures -->"


def outcomes(scenario: Scenario) -> Iterator[dict[str, Any]]:
    """One row per driven group of one run, and one per group left to SUMO."""
    with tempfile.TemporaryDirectory() as scratch:
        files = SumoFiles(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        outcome = run(scenario, files, driver_of(scenario, None), lambda *_: None)
    for counterpart, episodes in ((False, outcome.episodes), (True, outcome.left_to_sumo)):
        for number, episode in enumerate(episodes):
            contacts = sum(contact.after_hand_back for contact in episode.counted_contacts)
            yield {
                "episode": number,
                "counterpart": counterpart,
                "ending": episode.ending.value,
                **hand_back_columns(episode),
                "contacts_after": contacts,
            }


def line(name: str, rows: pd.DataFrame) -> list[str]:
    """One line of the page: a driver in a scenario."""
    braking, jerk = rows["braking_after"], rows["jerk_after"]
    shares = [f"{100 * (braking >= limit).mean():.1f}" for limit in BRAKING]
    rough = f"{100 * (jerk > MOST_JERK + 1e-6).mean():.1f}"
    contacts = int((rows["ending"] == "contact").sum()), int((rows["contacts_after"] > 0).sum())
    return [name, str(len(rows)), *shares, f"{braking.max():.1f}", f"{jerk.max():.1f}", rough, *map(str, contacts)]


def table(groups: pd.DataFrame) -> str:
    """The table of the page from the rows of all groups."""
    lines = []
    for scenario in groups["scenario"].unique():
        for counterpart, name in DRIVERS.items():
            rows = groups[(groups["scenario"] == scenario) & (groups["counterpart"] == counterpart)]
            lines.append(line(f"{scenario}, {name}", rows))
    return markdown_table(HEAD, lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--groups", type=int, default=200, help="driven groups per scenario")
    parser.add_argument("--per-seed", type=int, default=50, help="driven groups per seed")
    parser.add_argument("--seeds", type=int, default=20, help="at most that many seeds per scenario")
    parser.add_argument("--recording", type=Path, help="the NGSIM file of us101_replay")
    parser.add_argument("--rows", type=Path, default=Path("docs/results/hand_back.csv"))
    parser.add_argument("--page", type=Path, default=Path("docs/hand-back.md"))
    options = parser.parse_args()
    torch.set_num_threads(1)
    groups = pd.read_csv(options.rows) if options.rows.is_file() else pd.DataFrame()
    for seed in range(1, options.seeds + 1):
        for name in options.scenarios:
            known = groups[groups["scenario"] == name] if len(groups) else groups
            wanted = options.groups - (int((~known["counterpart"]).sum()) if len(known) else 0)
            if wanted <= 0 or (len(known) and seed in set(known["seed"])):
                continue
            scenario = load_scenario(name)
            if options.recording is not None:
                scenario = with_recording(scenario, options.recording)
            scenario = msgspec.structs.replace(scenario, seed=seed, watch=10.0, episodes=min(wanted, options.per_seed))
            rows = pd.DataFrame(outcomes(scenario))
            rows.insert(0, "scenario", name)
            rows.insert(1, "seed", seed)
            groups = pd.concat([groups, rows], ignore_index=True)
            groups.round(3).to_csv(options.rows, index=False)
            before, _, rest = options.page.read_text().partition(BEGIN)
            options.page.write_text(f"{before}{BEGIN}{table(groups)}{END}{rest.partition(END)[2]}")
            print(f"{name}, seed {seed}: {int((~rows['counterpart']).sum())} groups", flush=True)


if __name__ == "__main__":
    main()
