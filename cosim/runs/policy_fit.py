"""Whether a policy fits a scenario, from what its file and the scenario say; needs neither torch nor SUMO."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from cosim.spec import scenario as spec
from cosim.spec.input_files import checkpoint_path
from gri.core.edges import FOLLOWING, LANE_CHANGING, Vocabulary
from gri.errors import InputError
from gri.storage.checkpoint_header import checked_header

NO_MEANING = "nri"
"""The objective whose edge types have no meaning."""


def check_named_policy(scenario: spec.Scenario) -> None:
    """Check what can be checked of a scenario's policy before torch is imported; nothing of a user's own policy.

    Raises:
        InputError: as `cosim.runs.policy_loading.policy_of`, which checks the rest.
    """
    match scenario.policy:
        case spec.TrainedPolicy(checkpoint=name) as choice:
            path = checkpoint_path(name)
            header = checked_header(path)
            if choice.sees == "everybody":
                check_meaning(header.objective, path)
            check_vocabulary(header.vocabulary, scenario.group, path)
            any_size = header.config.get("pair_encoder") is not None or header.config.get("encoder") is None
            check_size(any_size, scenario.group, path)
            dynamics = str(header.config.get("dynamics", layout_wanted(scenario.group)))
            check_layout(dynamics, header.state, header.dt, header.history_steps, scenario)
        case spec.LeftToSumo() | spec.UserPolicy() | spec.SumoModel():
            pass
        case _:
            period = scenario.policy_period or scenario.step
            check_layout(layout_wanted(scenario.group), (), period, 1, scenario)


def layout_wanted(rule: spec.GroupRule) -> str:
    """The name of the state layout (`gri.core.dynamics.DynamicsName`) that a group rule is driven with."""
    return "point_mass_1d" if isinstance(rule, spec.CarFollowing) else "dubins"


def vocabulary_wanted(rule: spec.GroupRule) -> Vocabulary:
    """The edge types that a group rule is driven with."""
    return FOLLOWING if isinstance(rule, spec.CarFollowing) else LANE_CHANGING


def check_vocabulary(vocabulary: Sequence[str], rule: spec.GroupRule, path: Path) -> None:
    """Raise `InputError` where a model knows other edge types than the group rule wants."""
    wanted = vocabulary_wanted(rule)
    if tuple(vocabulary) != wanted:
        raise InputError(
            f"{path}: got the edge vocabulary ({', '.join(vocabulary)}), the group rule"
            f" {spec.tag_of(rule)!r} wants ({', '.join(wanted)}); choose another policy.checkpoint"
        )


def check_meaning(objective: str, path: Path) -> None:
    """Raise `InputError` where a model of this objective has not learned what it is to follow."""
    if objective == NO_MEANING:
        raise InputError(
            f"{path}: got policy.sees: everybody for a model of {objective}, whose edge types have no meaning, so"
            " that it has not learned to follow; write policy.sees: group, or choose another policy.checkpoint"
        )


def seen_like(named: spec.Driver, path: Path) -> Literal["group", "everybody"]:
    """What a checkpoint is to see beside the policy that a scenario names: as much, if it has learned to follow.

    Raises:
        InputError: the file is no checkpoint.
    """
    if not isinstance(named, spec.TrainedPolicy) or named.sees == "group":
        return "group"
    return "group" if checked_header(path).objective == NO_MEANING else "everybody"


def check_size(any_size: bool, rule: spec.GroupRule, path: Path) -> None:
    """Raise `InputError` where a model that takes groups of three only gets others.

    The paper's encoder embeds all vehicles together and has seen three; a given graph is that of three as well.
    """
    if rule.size != spec.USUAL_SIZE and not any_size:
        raise InputError(
            f"{path}: got a model for groups of three, group.size is {rule.size}; set it to 3, or choose a"
            " policy.checkpoint whose encoder compares pairs, such as us101_car_following"
        )


def check_layout(dynamics: str, state: Sequence[str], dt: float, history_steps: int, scenario: spec.Scenario) -> None:
    """Raise `InputError` where a policy does not fit the scenario.

    Args:
        dynamics: the name of its state layout.
        state: the features of that layout, for the message.
        dt: its period [s].
        history_steps: the states that it wants of the past.
        scenario: what it is to drive in.
    """
    layout = layout_wanted(scenario.group)
    if dynamics != layout:
        raise InputError(
            f"policy: got a policy for {dynamics} states {tuple(state)}, the group rule"
            f" {spec.tag_of(scenario.group)!r} wants {layout} states; choose another policy"
        )
    if not _is_multiple(dt, scenario.step):
        raise InputError(
            f"step: got {scenario.step:g} s, the policy acts every {dt:g} s; set step to that, or to a whole"
            " fraction of it"
        )
    if scenario.policy_period and abs(dt - scenario.policy_period) > 1e-9:
        raise InputError(
            f"policy_period: got {scenario.policy_period:g} s, the policy acts every {dt:g} s; set it to that,"
            " or leave it out"
        )
    if scenario.reinfer_s and not _is_multiple(scenario.reinfer_s, dt):
        raise InputError(
            f"reinfer_s: got {scenario.reinfer_s:g} s, the policy acts every {dt:g} s; set it to a multiple"
        )
    if history_steps * dt > scenario.history + 1e-9:
        needed = history_steps * dt
        raise InputError(
            f"history: got {scenario.history:g} s, the policy wants {history_steps} states; set history to at"
            f" least {needed:g}"
        )


def _is_multiple(duration: float, of: float) -> bool:
    return round(duration / of) >= 1 and abs(duration / of - round(duration / of)) < 1e-6
