"""What perturbations of the traffic reach: density, flow, speed, waiting vehicles and driver types, each against the
unperturbed traffic of the same seed. Five simulations a scenario, about a minute of processor time.

    python benchmarks/perturbed_traffic.py us101_car_following i80_car_following curved_merge
"""

import argparse
import multiprocessing

from msgspec.structs import replace

from cosim.perturb.effects import Effect, effects_table, shown_effects
from cosim.runs.traffic_effects import compared_traffic, survey_traffic
from cosim.spec.loading import load_scenario, override
from cosim.spec.perturbations import AggressiveDrivers, DenserTraffic, LowFriction, MoreTrucks, Perturbation
from cosim.spec.scenario import Scenario
from gri.table import terminal_text

SPECS: tuple[Perturbation, ...] = (
    DenserTraffic(intensity=1.1),
    DenserTraffic(intensity=1.25),
    MoreTrucks(intensity=0.5),
    AggressiveDrivers(intensity=1.0),
    LowFriction(intensity=0.15),
)


def effects(scenario: Scenario) -> list[Effect]:
    """The effects of all perturbations; one simulation at a time."""
    before = survey_traffic(scenario, lambda *_: None)
    found: list[Effect] = []
    for spec in SPECS:
        perturbed = replace(scenario, perturbations=(spec,))
        found += compared_traffic(perturbed, before, survey_traffic(perturbed, lambda *_: None))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="+")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    scenarios = [override(load_scenario(name), {"seed": options.seed}) for name in options.scenarios]
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for name, found in zip(options.scenarios, pool.imap(effects, scenarios), strict=True):
            print(
                f"{name}, seed {options.seed}\n{terminal_text(shown_effects(effects_table(found)), 80)}\n", flush=True
            )


if __name__ == "__main__":
    main()
