"""From the policy that a scenario names to a policy object that fits the scenario."""

from pathlib import Path

import msgspec

from cosim.loop.driving import Driver
from cosim.loop.own_policy import OwnPolicy
from cosim.runs.policy_fit import NO_MEANING, check_layout, check_meaning, check_size, check_vocabulary
from cosim.runs.user_policy import own_name, own_policy
from cosim.spec import scenario as spec
from cosim.spec.input_files import checkpoint_path
from cosim.world.road_frame import NOMINAL_LENGTH
from gri import checkpoint
from gri.core.dynamics import DUBINS, POINT_MASS_1D
from gri.core.merging_policy import MergingDriver
from gri.core.policy import ConstantVelocity, IntelligentDriver, Policy
from gri.errors import InputError
from gri.networks.model import CHAIN, RelationalModel
from gri.networks.next_ahead import FollowsNextAhead
from gri.networks.pair_encoder import PairEncoder
from gri.reference_drivers.drivers import DriverName


def driver_of(scenario: spec.Scenario, own: Policy | None = None) -> Driver | None:
    """The policy of a scenario under the scenario's graph source; None where SUMO drives.

    `own` is a policy object that takes the place of the policy that the scenario names.

    Raises:
        InputError: the policy does not fit the group rule, the step or the history.
    """
    if own is not None:
        check_fit(own, scenario)
    policy = own or policy_of(scenario)
    if own is None and isinstance(scenario.policy, spec.SumoDriver):
        return Driver(_models(scenario.traffic), None)
    if policy is None:
        return None
    name = _name(scenario.policy, policy)
    if isinstance(scenario.policy, spec.UserPolicy):
        policy = OwnPolicy(policy, scenario.policy.decision_limit)
    reference = reference_of(scenario.policy) if own is None else None
    return Driver(
        name,
        policy,
        _with_meaning(scenario.graph, name),
        scenario.steps(scenario.reinfer_s),
        reference=reference,
        safety=scenario.safety,
        predicts=scenario.predictor != "none",
    )


def _models(traffic: spec.Traffic) -> str:
    """The names of the car-following models of the traffic's drivers, such as EIDM."""
    return "+".join(sorted({str(kind.car_following) for kind in traffic.vehicles}))


def _with_meaning(source: spec.GraphSource, name: str) -> spec.GraphSource:
    """The source of the graph; NRI's types have no meaning of their own, so that nothing is decided by them."""
    if name == NO_MEANING and isinstance(source, spec.Inferred):
        return msgspec.structs.replace(source, in_doubt="ignore")
    return source


def reference_of(choice: spec.Driver) -> DriverName | None:
    """The reference driver that a policy names; None for any other policy."""
    if isinstance(choice, spec.CarefulHuman):
        return DriverName.CAREFUL_HUMAN_WANDERING if choice.variant == "wandering" else DriverName.CAREFUL_HUMAN
    return DriverName(spec.tag_of(choice)) if isinstance(choice, spec.ReferencePolicy) else None


def _name(choice: spec.Driver, policy: Policy) -> str:
    """The kind of policy; for a checkpoint the objective it was trained with, for an own policy its own name."""
    if isinstance(choice, spec.TrainedPolicy):
        return checkpoint.objective(checkpoint_path(choice.checkpoint))
    if (reference := reference_of(choice)) is not None:
        return reference.value
    return own_name(policy) if isinstance(choice, spec.UserPolicy) else spec.tag_of(choice)


def policy_of(scenario: spec.Scenario) -> Policy | None:
    """The policy that a scenario names; None where the group is left to SUMO.

    Raises:
        InputError: the policy does not fit the group rule, the step or the history.
    """
    in_lane = isinstance(scenario.group, spec.CarFollowing)
    period = scenario.policy_period or scenario.step
    match scenario.policy:
        case spec.LeftToSumo() | spec.SumoDriver():
            return None
        case spec.Idm() | spec.R157() | spec.CarefulHuman() | spec.Fsm() | spec.Rss() as kind:
            alone = isinstance(kind, spec.Idm) and kind.sees == "group"
            model = IntelligentDriver(period, length=NOMINAL_LENGTH, sees_nearby=not alone)
            policy: Policy = model if in_lane else MergingDriver(model)
        case spec.ConstantVelocity():
            policy = ConstantVelocity(period, POINT_MASS_1D if in_lane else DUBINS)
        case spec.TrainedPolicy(checkpoint=name) as choice:
            path = checkpoint_path(name)
            model = checkpoint.load(path)
            check_vocabulary(model.config.vocabulary, scenario.group, path)
            given_chain = model.encoder is None and model.config.graph == CHAIN
            check_size(isinstance(model.encoder, PairEncoder) or given_chain, scenario.group, path)
            policy = model if choice.sees == "group" else following_next_ahead(model, path)
        case spec.UserPolicy() as own:
            policy = own_policy(own, period)
        case spec.SumoModel(model=name):
            raise InputError(f"policy: got SUMO's model {name}, which drives no groups; add a share to the scenario")
    check_fit(policy, scenario)
    return policy


def following_next_ahead(model: RelationalModel, path: Path) -> FollowsNextAhead:
    """The model of a checkpoint as a policy that follows who is next ahead. Raises `InputError` where it cannot."""
    check_meaning(checkpoint.objective(path), path)
    try:
        return FollowsNextAhead(model)
    except ValueError as error:
        raise InputError(f"{path}: policy.sees: {error}; leave it out, or choose another policy.checkpoint") from None


def check_fit(policy: Policy, scenario: spec.Scenario) -> None:
    """Raise an InputError where a policy's states, period or history do not fit the scenario."""
    dynamics = policy.dynamics
    check_layout(dynamics.name, dynamics.state, policy.dt, policy.history_steps, scenario)
