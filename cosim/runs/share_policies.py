"""From the shares of a scenario to what drives them."""

from msgspec.structs import replace

from cosim.loop.own_policy import OwnPolicy
from cosim.loop.pair_policy import PairPolicy, pair_policy
from cosim.loop.share_of_traffic import SharePlan
from cosim.process.timed_calls import TimedCalls
from cosim.runs.policy_loading import policy_of
from cosim.spec.input_files import checkpoint_path
from cosim.spec.scenario import CarFollowing, Driver, LeftToSumo, Scenario, TrainedPolicy, UserPolicy
from cosim.spec.shares import driven_shares
from cosim.spec.sumo_models import SumoModel
from gri import checkpoint
from gri.core.dynamics import DynamicsName
from gri.errors import InputError


def share_plans(scenario: Scenario) -> dict[str, SharePlan]:
    """What drives each share, by name; shares that are left to SUMO have none.

    Raises:
        InputError: a policy does not drive along its lane, or does not fit the step.
    """
    reinfer = scenario.steps(scenario.reinfer_s)
    plans = {}
    for name, (choice, share) in driven_shares(scenario).items():
        if isinstance(choice, SumoModel):
            plans[name] = SharePlan(share, choice)
        elif not isinstance(choice, LeftToSumo):
            plans[name] = SharePlan(share, _in_pairs(choice, scenario), reinfer)
    return plans


def _in_pairs(choice: Driver, scenario: Scenario) -> PairPolicy:
    if isinstance(choice, TrainedPolicy):
        path = checkpoint_path(choice.checkpoint)
        if (layout := checkpoint.load(path).dynamics.name) is not DynamicsName.POINT_MASS_1D:
            raise InputError(
                f"policy.checkpoint: got {choice.checkpoint}, which drives merges ({layout} states); a share of the"
                " traffic is driven along its lane, with lanes left to SUMO; choose a car-following checkpoint, such"
                " as us101_car_following"
            )
    alone = replace(scenario, policy=choice, share=None, shares={}, group=CarFollowing())
    policy = policy_of(alone)
    assert policy is not None, "left to SUMO has no plan"
    if abs(policy.dt - scenario.step) > 1e-9:
        raise InputError(
            f"step: got {scenario.step:g} s, the policy acts every {policy.dt:g} s; a share is commanded in every step,"
            " so set step to that"
        )
    if isinstance(choice, UserPolicy):
        policy = OwnPolicy(policy, choice.decision_limit, TimedCalls(limit=choice.decision_limit))
    return pair_policy(policy, scenario.graph)
