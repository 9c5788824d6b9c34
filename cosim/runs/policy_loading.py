"""From the policy that a scenario names to a policy object that fits the scenario."""

from pathlib import Path

import msgspec

from cosim.loop.driving import Driver
from cosim.loop.own_policy import OwnPolicy
from cosim.runs.user_policy import own_name, own_policy
from cosim.spec import scenario as spec
from cosim.spec.input_files import checkpoint_path
from cosim.world.road_frame import NOMINAL_LENGTH
from gri import checkpoint
from gri.core.dynamics import DUBINS, POINT_MASS_1D, DynamicsName
from gri.core.graph import FOLLOWING, LANE_CHANGING, Vocabulary
from gri.core.merging_policy import MergingDriver
from gri.core.policy import ConstantVelocity, IntelligentDriver, Policy
from gri.errors import InputError
from gri.networks.model import CHAIN, RelationalModel
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


def _with_meaning(source: spec.GraphSource, name: str) -> spec.GraphSource:
    """The source of the graph; NRI's types have no meaning of their own, so that nothing is decided by them."""
    if name == "nri" and isinstance(source, spec.Inferred):
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
        case spec.LeftToSumo():
            return None
        case spec.Idm() | spec.R157() | spec.CarefulHuman() | spec.Fsm() | spec.Rss() as kind:
            alone = isinstance(kind, spec.Idm) and kind.sees == "group"
            model = IntelligentDriver(period, length=NOMINAL_LENGTH, sees_nearby=not alone)
            policy: Policy = model if in_lane else MergingDriver(model)
        case spec.ConstantVelocity():
            policy = ConstantVelocity(period, POINT_MASS_1D if in_lane else DUBINS)
        case spec.TrainedPolicy(checkpoint=name):
            path = checkpoint_path(name)
            model = checkpoint.load(path)
            _check_vocabulary(model, scenario.group, path)
            _check_size(model, scenario.group, path)
            policy = model
        case spec.UserPolicy() as own:
            policy = own_policy(own, period)
        case spec.SumoModel(model=name):
            raise InputError(f"policy: got SUMO's model {name}, which drives no groups; add a share to the scenario")
    check_fit(policy, scenario)
    return policy


def _wanted(rule: spec.GroupRule) -> tuple[DynamicsName, Vocabulary]:
    """State layout and edge vocabulary that a group rule is driven with."""
    if isinstance(rule, spec.CarFollowing):
        return DynamicsName.POINT_MASS_1D, FOLLOWING
    return DynamicsName.DUBINS, LANE_CHANGING


def _check_vocabulary(model: RelationalModel, rule: spec.GroupRule, path: Path) -> None:
    wanted = _wanted(rule)[1]
    if model.config.vocabulary != wanted:
        raise InputError(
            f"{path}: got the edge vocabulary ({', '.join(model.config.vocabulary)}), the group rule"
            f" {spec.tag_of(rule)!r} wants ({', '.join(wanted)}); choose another policy.checkpoint"
        )


def _check_size(model: RelationalModel, rule: spec.GroupRule, path: Path) -> None:
    """The paper's encoder embeds all vehicles together and has seen three; a given graph is that of three as well."""
    any_size = isinstance(model.encoder, PairEncoder) or (model.encoder is None and model.config.graph == CHAIN)
    if rule.size != spec.USUAL_SIZE and not any_size:
        raise InputError(
            f"{path}: got a model for groups of three, group.size is {rule.size}; set it to 3, or choose a"
            " policy.checkpoint whose encoder compares pairs, such as us101_car_following"
        )


def check_fit(policy: Policy, scenario: spec.Scenario) -> None:
    """Raise an InputError where a policy's states, period or history do not fit the scenario."""
    layout = _wanted(scenario.group)[0]
    if policy.dynamics.name is not layout:
        raise InputError(
            f"policy: got a policy for {policy.dynamics.name} states {policy.dynamics.state}, the group rule"
            f" {spec.tag_of(scenario.group)!r} wants {layout} states; choose another policy"
        )
    if not _is_multiple(policy.dt, scenario.step):
        raise InputError(
            f"step: got {scenario.step:g} s, the policy acts every {policy.dt:g} s; set step to that, or to a whole"
            " fraction of it"
        )
    if scenario.policy_period and abs(policy.dt - scenario.policy_period) > 1e-9:
        raise InputError(
            f"policy_period: got {scenario.policy_period:g} s, the policy acts every {policy.dt:g} s; set it to that,"
            " or leave it out"
        )
    if scenario.reinfer_s and not _is_multiple(scenario.reinfer_s, policy.dt):
        raise InputError(
            f"reinfer_s: got {scenario.reinfer_s:g} s, the policy acts every {policy.dt:g} s; set it to a multiple"
        )
    if policy.history_steps * policy.dt > scenario.history + 1e-9:
        needed = policy.history_steps * policy.dt
        raise InputError(
            f"history: got {scenario.history:g} s, the policy wants {policy.history_steps} states; set history to at"
            f" least {needed:g}"
        )


def _is_multiple(duration: float, of: float) -> bool:
    return round(duration / of) >= 1 and abs(duration / of - round(duration / of)) < 1e-6
