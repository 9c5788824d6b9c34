"""Shares of the traffic that policies drive: which ones a scenario has, and which other fields fit them."""

from typing import TYPE_CHECKING

from cosim.spec.perturbations import CHANGES_DEMAND
from cosim.spec.policies import ReferencePolicy
from cosim.spec.sumo_models import SumoModel

if TYPE_CHECKING:
    from cosim.spec.scenario import Driver, Scenario


def driven_shares(scenario: "Scenario") -> "dict[str, tuple[Driver, float]]":
    """The policies that drive shares of the traffic, by name, with their shares.

    The policy of `share` has the name of its kind, a model of SUMO that of the model.
    """
    own = {} if scenario.share is None else {share_name(scenario.policy): (scenario.policy, scenario.share)}
    return own | {name: (part.policy, part.share) for name, part in scenario.shares.items()}


def share_name(choice: "Driver") -> str:
    """The name of a policy that has none of its own: its kind, its model, or the class or function in its file."""
    if isinstance(choice, SumoModel):
        return choice.model
    of_user = getattr(choice, "object", "")
    return of_user.rpartition(":")[2] or str(choice.__struct_config__.tag)


def check_shares(scenario: "Scenario", replayed: bool) -> None:
    """Raise `ValueError` where the shares do not fit each other or the rest of the scenario."""
    if not scenario.has_shares:
        if isinstance(scenario.policy, SumoModel):
            raise ValueError(
                "policy is a model of SUMO, which drives no groups but a share of the traffic; add a share"
            )
        return
    if scenario.share is not None and (name := share_name(scenario.policy)) in scenario.shares:
        raise ValueError(f"shares has {name!r}, which is the name of the policy of `share`; expected another name")
    if (total := sum(share for _, share in driven_shares(scenario).values())) > 1 + 1e-9:
        raise ValueError(f"the shares add up to {total:g}, expected at most 1")
    for name, (choice, _) in driven_shares(scenario).items():
        if isinstance(choice, ReferencePolicy):
            raise ValueError(f"the share {name!r} has a reference driver, which drives groups; expected another policy")
    if scenario.safety is not None:
        raise ValueError("safety filters the policy of groups, but a share drives single vehicles; remove one of both")
    if scenario.predictor != "none":
        raise ValueError("predictor is for the policy of groups, which a perturbation shows late states; remove it")
    if replayed:
        raise ValueError("background replays a recording, but a share drives simulated traffic; remove one of both")
    for change in scenario.perturbations:
        if not isinstance(change, CHANGES_DEMAND):
            raise ValueError(
                f"perturbations has {change.kind}, which is for groups; with a share only the demand changes"
            )
