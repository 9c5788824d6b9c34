"""Do background vehicles drive into a vehicle that merges? Driven vehicles merge into dense traffic on both nets.

Only the merger is driven (by the untrained merging driver). SUMO drives the lag vehicle and the leader, so SUMO's
drivers must see a vehicle that is between two lanes. The same groups are driven with shadow vehicles
(`cosim.loop.shadow_vehicles`) and without. A contact counts as "into the driven vehicle" where the front of the other
vehicle is farther back.

    python benchmarks/straddling.py
"""

import argparse
import tempfile
import time
from collections import Counter
from pathlib import Path
from unittest.mock import patch

import msgspec
import torch

from cosim.loop import shadow_vehicles
from cosim.loop.closed_loop import run
from cosim.loop.driving import Driver
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.traffic.simulation_input import SumoFiles
from cosim.world.episode import Ending, Episode, EventKind
from gri.core.merging_policy import MergingDriver
from gri.core.policy import IntelligentDriver

DRIVER = Driver("merging driver", MergingDriver(IntelligentDriver(0.2)))


def merges(site: str, seed: int, count: int) -> list[Episode]:
    """At most `count` merges of one seed, from half an hour of traffic."""
    scenario = load_scenario(f"{site}_merge")
    scenario = msgspec.structs.replace(scenario, seed=seed, episodes=count, driven=(0,), time_limit=1800.0)
    with tempfile.TemporaryDirectory() as scratch:
        files = SumoFiles(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        return list(run(scenario, files, DRIVER, lambda *_: None).episodes)


def outcome(episode: Episode) -> str:
    """How a merge ended; for a contact, which vehicle drove into which."""
    if episode.ending is not Ending.CONTACT:
        return episode.ending.value
    hit = next(event for event in episode.events if event.kind is EventKind.CONTACT)
    background = hit.vehicles[0] != episode.group.ids[0]  # the one that is farther back stands first
    return f"contact: {'background into the driven vehicle' if background else 'driven vehicle into the background'}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sites", nargs="+", default=["us101", "i80"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--count", type=int, default=25, help="merges per site and seed")
    options = parser.parse_args()
    torch.set_num_threads(1)
    for with_shadows in (True, False):
        found: Counter[str] = Counter()
        disagreements, began = 0, time.monotonic()
        for site in options.sites:
            for seed in options.seeds:
                mechanism = shadow_vehicles.place if with_shadows else lambda *_: ""
                with patch("cosim.loop.shadow_vehicles.place", mechanism):
                    episodes = merges(site, seed, options.count)
                found.update(outcome(episode) for episode in episodes)
                kinds = [event.kind for episode in episodes for event in episode.events]
                disagreements += kinds.count(EventKind.DISAGREEMENT)
        name, seconds = "with" if with_shadows else "without", time.monotonic() - began
        print(f"{name} shadow vehicles: {found.total()} merges, {seconds:.0f} s")
        for ending, count in found.most_common():
            print(f"  {ending}: {count}")
        print(f"  steps in which only one of SUMO and the box test saw a contact: {disagreements}")


if __name__ == "__main__":
    main()
