"""Which runs have the same warm-up."""

import hashlib

import msgspec
from msgspec.structs import replace

from cosim.spec.perturbations import CHANGES_DEMAND
from cosim.spec.scenario import LeftToSumo, Replay, Scenario


def warm_up_key(scenario: Scenario) -> str:
    """The same text for scenarios that differ in the policy and in perturbations of single groups only.

    "" where a run needs a process of its own: with perturbed traffic, which is measured besides, with a recording, with
    SUMO files of the user, where policies drive shares of the traffic, and where there is nothing to share.
    """
    own_process = scenario.traffic.has_own_files or scenario.has_shares or isinstance(scenario.background, Replay)
    if (
        own_process
        or not scenario.traffic.warm_up
        or any(isinstance(p, CHANGES_DEMAND) for p in scenario.perturbations)
    ):
        return ""
    content = msgspec.json.encode(replace(scenario, policy=LeftToSumo(), perturbations=(), description=""))
    return hashlib.sha256(content).hexdigest()
