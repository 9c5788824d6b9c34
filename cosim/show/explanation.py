"""An episode explained in text: the graph that the policy inferred, why it acted as it did, and what its reward says.

Why: the policy decides again without an edge (`cosim.show.action_effects`), and the text says what the edge did to the
acceleration. Reward: its weighted terms (gri.rewards.structured) are evaluated on the recorded drive, in the frame of
the model; the largest are named.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import fill

import numpy as np
from jaxtyping import Float
from torch import Tensor

from cosim.runs.finished_run import read_scenario
from cosim.runs.policy_loading import policy_of
from cosim.runs.summary import driver_name
from cosim.show.action_effects import AGREES, FAR, LOOK_BACK, Effect, drive_of, effect_of_vehicle, effects_of
from cosim.show.episode_view import EpisodeView, InferredEdge
from cosim.spec.input_files import checkpoint_path
from cosim.spec.scenario import CarFollowing, Scenario, TrainedPolicy
from gri import checkpoint
from gri.core.dynamics import DUBINS, POINT_MASS_1D
from gri.core.graph import EdgeType
from gri.errors import InputError
from gri.rewards.structured import StructuredReward

WIDTH = 80  # columns
SMALL = 0.05  # [m/s²]; smaller effects round to nothing
OVER = 3.0  # [s] from the take-over on, over which the effect of a whole vehicle is told
APART = 0.5  # [s] between two moments that are told
VERBS = {"follow": "follows", "yield": "yields to", "cut_in": "cuts in ahead of"}
MEANING = {
    ("node", "speed"): "keeping the desired speed",
    ("node", "acceleration"): "driving without acceleration",
    ("node", "jerk"): "driving without jerk",
    ("node", "heading"): "staying parallel to the road",
    ("node", "yaw_rate"): "not turning",
    ("node", "yaw_acceleration"): "a small yaw acceleration",
    ("node", "lane"): "being in the target lane",
    ("node", "lateral_speed"): "no speed across the road",
    ("node", "lateral_acceleration"): "no acceleration across the road",
    ("node", "lateral_jerk"): "no jerk across the road",
    ("follow", "speed"): "driving at the leader's speed",
    ("follow", "headway"): "keeping the learned headway",
    ("follow", "idm"): "keeping the headway of the intelligent driver model",
    ("follow", "dist"): "not coming too close",
    ("follow", "lat"): "being in the same lane",
    ("yield", "spatial"): "leaving distance at the point of collision",
    ("yield", "time"): "leaving time at the point of collision",
    ("yield", "yield"): "leaving the headway that yielding asks for",
    ("yield", "dist"): "not coming too close",
    ("cut_in", "goal"): "getting ahead by the headway that cutting in asks for",
    ("cut_in", "dist"): "not coming too close",
}


@dataclass(frozen=True)
class Term:
    """One weighted term of the reward along a drive: its cost (−reward, ≥ 0, without unit) at each of T steps."""

    group: str  # "node", or the type of the relation
    name: str
    sender: int | None
    cost: Float[np.ndarray, " T"]

    @property
    def meaning(self) -> str:
        meaning = MEANING.get((self.group, self.name), f"the term {self.name}")
        return meaning if self.sender is None else f"{meaning} towards {self.sender}"


def explanation(view: EpisodeView, run: Path) -> str:
    """The inferred graph, the drive and its reasons, as text of at most 80 columns. `run` is the run folder."""
    scenario = read_scenario(run)
    driven = [role for role in range(view.size - 1) if view.driven[:, role].any()]
    again = _decided_again(view, scenario, driven)
    reward = None
    if isinstance(scenario.policy, TrainedPolicy):
        reward = checkpoint.load_reward(checkpoint_path(scenario.policy.checkpoint))
    lines = [_headline(view), "", *_graph(view)]
    for role in range(view.size - 1):
        lines += ["", *_drive(view, role)]
        if role in driven:
            own = [effect for effect in again.effects if effect.receiver == role]
            lines += [f"  {again.remark}"] if again.remark else _why(own)
            lines += _because_of(again.of_vehicles.get(role, {}), again.over)
        if role in driven and view.inferred_edges:
            lines += _reasons(view, role, scenario, reward)
    return "\n".join(_wrapped(line) for line in lines)


def _wrapped(line: str) -> str:
    indent = " " * (len(line) - len(line.lstrip()))
    return fill(line, WIDTH, subsequent_indent=indent + "  ", break_long_words=False, break_on_hyphens=False)


@dataclass(frozen=True)
class _DecidedAgain:
    """The effects of all reasons; those of whole vehicles by receiver and sender over some time; why there are none."""

    effects: Sequence[Effect] = ()
    of_vehicles: Mapping[int, Mapping[int, float]] = field(default_factory=dict)  # [m/s²]
    over: float = 0.0  # [s]
    remark: str = ""


def _decided_again(view: EpisodeView, scenario: Scenario, driven: Sequence[int]) -> _DecidedAgain:
    """What the policy would have done without an edge, or a vehicle."""
    if not driven:
        return _DecidedAgain()
    try:
        policy = policy_of(scenario)
    except (ImportError, InputError) as error:
        return _DecidedAgain(remark=f"Its policy cannot decide again, because it cannot be loaded: {error}")
    drive = drive_of(view, scenario)
    if policy is None or len(drive.state) < 2:
        return _DecidedAgain(remark="The drive is too short to decide again.")
    effects, steps = effects_of(drive, policy, driven), min(round(OVER / policy.dt), len(drive.state) - 1)
    of_vehicles: dict[int, dict[int, float]] = {}
    if drive.graphs and all(effect.agrees[:steps].all() for effect in effects):
        for sender in range(view.size):
            found = effect_of_vehicle(drive, policy, sender, driven, steps)
            for receiver in driven:
                if receiver != sender:
                    of_vehicles.setdefault(receiver, {})[sender] = float(found[receiver])
    return _DecidedAgain(effects, of_vehicles, steps * policy.dt)


def _because_of(of_vehicles: Mapping[int, float], over: float) -> Iterator[str]:
    """What each vehicle as a whole did to one, the largest effect first."""
    mattered = sorted((item for item in of_vehicles.items() if abs(item[1]) >= SMALL), key=lambda item: -abs(item[1]))
    if mattered:
        what = ", ".join(f"`{sender}` {_signed(effect)} m/s²" for sender, effect in mattered)
        yield (
            f"  Because of whom: mean effect of a whole vehicle over the first {over:.1f} s, by way of others that the"
            f" policy drives included: {what}."
        )


def _why(effects: Sequence[Effect]) -> Iterator[str]:
    """What the reasons of one vehicle did: on average, and at the moments with the largest effects."""
    if not effects:
        yield "  No edge leads to it: nothing that another vehicle does changes its actions."
        return
    single = [effect for effect in effects if " and " not in effect.reason]
    agrees = effects[0].agrees
    if not agrees.any():
        yield (
            "  The policy does not give the recorded accelerations when it decides again: its sensing or its actions"
            " were perturbed, or it reacted to a vehicle outside the group. So no reasons are given."
        )
        return
    means = ", ".join(f"`{e.reason}` {_signed(e.second[agrees].mean())} m/s²" for e in effects)
    yield (
        "  What made it act: mean effect on its acceleration over the drive, compared with driving without it for the"
        f" last {LOOK_BACK:g} s: {means}."
    )
    largest = [float(np.abs(effect.second[agrees]).max()) for effect in effects]
    for effect, most in zip(effects, largest, strict=True):
        if most < SMALL:
            yield f"  `{effect.reason}` did not matter: it changed the acceleration by {most:.2f} m/s² at most."
    mattered = [effect for effect, most in zip(effects, largest, strict=True) if most >= SMALL]
    for k in _moments(mattered):
        yield "  " + _moment(mattered, k)
    across = max(single, key=lambda effect: float(np.abs(effect.lateral * agrees).max()))
    k = int(np.abs(across.lateral * agrees).argmax())
    if abs(across.lateral[k]) >= SMALL:
        side = "left" if across.lateral[k] > 0 else "right"
        yield (
            f"  Across the road: at {across.time[k]:.1f} s `{across.reason}` pulled it to the {side} by"
            f" {abs(across.lateral[k]):.1f} m/s²."
        )
    if not agrees.all():
        yield (
            f"  At {int((~agrees).sum())} of {len(agrees)} instants the policy does not give the recorded acceleration"
            f" again (difference above {AGREES:g} m/s²: perturbed sensing or control, or a vehicle outside the group);"
            " they are left out."
        )


def _moments(effects: Sequence[Effect]) -> list[int]:
    """Instants in order: the hardest braking, and the largest effect of each reason; at least `APART` from another."""
    if not effects:
        return []
    agrees, time = effects[0].agrees, effects[0].time
    wanted = [int(np.where(agrees, effects[0].acceleration, np.inf).argmin())]
    wanted += [int((np.abs(effect.second) * agrees).argmax()) for effect in effects]
    chosen: list[int] = []
    for k in wanted:
        if agrees[k] and all(abs(time[k] - time[other]) >= APART for other in chosen):
            chosen.append(k)
    return sorted(chosen)


def _moment(effects: Sequence[Effect], k: int) -> str:
    """What the vehicle did at instant k, and what it would have done without each reason."""
    now = float(effects[0].acceleration[k])
    parts = [f"At {effects[0].time[k]:.1f} s it {_did(now)}."]
    for effect in effects:
        change, decision = float(effect.second[k]), float(effect.decision[k])
        if abs(change) < SMALL:
            parts.append(f"Without `{effect.reason}` it would have done the same.")
        else:
            of_vehicle = effect.reason.startswith(("vehicle", "ahead"))
            what = "edges" if " and " in effect.reason else "vehicle" if of_vehicle else "edge"
            parts.append(
                f"Without `{effect.reason}` it would have {_did(now - change)}: the {what}"
                f" {'took' if change < 0 else 'added'} {abs(change):.1f} m/s²"
                f" ({_signed(decision)} m/s² in the last decision)."
            )
    return " ".join(parts)


def _did(acceleration: float) -> str:
    if abs(acceleration) < SMALL:
        return "kept its speed"
    return f"{'braked' if acceleration < 0 else 'accelerated'} at {_signed(acceleration)} m/s²"


def _signed(value: float) -> str:
    return f"{value:+.1f}".replace("-", "−") if abs(value) >= SMALL else "0.0"


def _headline(view: EpisodeView) -> str:
    names = ", ".join(f"{vehicle} ({role})" for role, vehicle in enumerate(view.ids))
    ended = str(view.group["ending"]).replace("_", " ")
    return (
        f"Episode {view.number}: {driver_name(view.driver)} drives a group of the vehicles {names}. Take-over at"
        f" {view.takeover_time:.1f} s; driven for {view.group['drive_duration']:.1f} s; ended by: {ended}."
    )


def _graph(view: EpisodeView) -> list[str]:
    """Every relation that the policy inferred at the take-over, and every later change."""
    if not view.inferred_edges:
        return [
            f"{driver_name(view.driver)} does not infer a graph. The effect of a vehicle is found by moving it"
            f" {FAR:g} m ahead."
        ]
    at_first = _at_takeover(view)
    lines = [
        f"{view.ids[e.receiver]} ({e.receiver}) {VERBS.get(e.type, e.type)} {view.ids[e.sender]} ({e.sender})"
        f" (p {e.probability:.2f}{', in doubt: nobody is more probable' if e.in_doubt else ''})."
        for e in at_first
        if e.type != "none"
    ] or ["No vehicle reacts to another one."]
    least_certain = min((e for e in at_first if e.type == "none"), key=lambda e: e.probability, default=None)
    if least_certain is not None:
        lines.append(
            "No other relation is inferred. The least certain pair is"
            f" {least_certain.sender} → {least_certain.receiver} (none with p {least_certain.probability:.2f})."
        )
    return lines + _changes(view.inferred_edges, view.takeover_time)


def _changes(edges: Sequence[InferredEdge], takeover_time: float) -> list[str]:
    latest: dict[tuple[int, int], str] = {}
    lines = []
    for edge in sorted(edges, key=lambda edge: edge.time):
        pair = (edge.sender, edge.receiver)
        if latest.get(pair, edge.type) != edge.type:
            lines.append(
                f"{edge.time - takeover_time:.1f} s after the take-over, {edge.sender} → {edge.receiver} changes from"
                f" {latest[pair]} to {edge.type} (p {edge.probability:.2f}{', in doubt' if edge.in_doubt else ''})."
            )
        latest[pair] = edge.type
    return lines


def _drive(view: EpisodeView, role: int) -> list[str]:
    """Speed, gap and braking of one vehicle from the take-over to the end of the drive."""
    during = view.during_drive
    v, a, gap = view.feature("v")[during, role], view.feature("a")[during, role], view.gap[during, role]
    time = view.time[during] - view.takeover_time
    hardest = int(a.argmin())
    driver = "driven by the policy" if view.driven[:, role].any() else "driven by SUMO"
    line = f"{view.ids[role]} ({role}), {driver}: {v[0]:.1f} m/s at the take-over, {v[-1]:.1f} m/s at the end"
    if np.isfinite(gap).all():
        line += f"; net gap {gap[0]:.1f} m at the take-over, {gap[-1]:.1f} m at the end,"
        line += f" smallest {gap.min():.1f} m after {time[gap.argmin()]:.1f} s"
    return [f"{line}; hardest braking {max(-a[hardest], 0.0):.1f} m/s² after {time[hardest]:.1f} s."]


def _reasons(view: EpisodeView, role: int, scenario: Scenario, reward: StructuredReward | None) -> list[str]:
    """The largest reward terms of one vehicle (at least 5 % of its cost), and when they were largest."""
    if reward is None:
        return ["  Its checkpoint has no reward, so there are no reward terms to show."]
    terms = sorted(terms_of(view, role, scenario, reward), key=lambda term: -term.cost.mean())
    total = sum(float(term.cost.mean()) for term in terms)
    if total < 1e-9:
        return ["  All terms of its reward are zero during the drive."]
    time = view.time[view.during_drive] - view.takeover_time
    lines = ["  Its reward on this drive, as shares of its cost (terms without unit):"]
    for term in terms:
        mean, peak = float(term.cost.mean()), int(term.cost.argmax())
        if mean >= 0.05 * total:
            lines.append(
                f"    {100 * mean / total:.0f} % {term.meaning} ({term.group} term {term.name}, mean {mean:.3g},"
                f" maximum {term.cost[peak]:.3g} after {time[peak]:.1f} s, {term.cost[-1]:.3g} at the end)."
            )
    return lines


def terms_of(view: EpisodeView, role: int, scenario: Scenario, reward: StructuredReward) -> list[Term]:
    """The weighted terms of one vehicle (not the leader) at every driven step, under the graph at the take-over."""
    state, action = model_states(view, scenario)
    own = state[role]
    columns = reward.node_features(own, action[role]) * reward.weights("node")
    terms = [Term("node", name, None, columns[:, k].numpy()) for k, name in enumerate(reward.names("node"))]
    for edge in _at_takeover(view):
        if edge.receiver == role and edge.type in {str(kind) for kind in reward.terms.edge}:
            kind = EdgeType(edge.type)
            columns = reward.edge_features(kind, state[edge.sender], own) * reward.weights(kind)
            terms += [
                Term(edge.type, name, edge.sender, columns[:, k].numpy())
                for k, name in enumerate(reward.names(edge.type))
            ]
    return terms


def _at_takeover(view: EpisodeView) -> list[InferredEdge]:
    """The edges that the policy inferred at the take-over."""
    first = min(edge.time for edge in view.inferred_edges)
    return [edge for edge in view.inferred_edges if edge.time == first]


def model_states(view: EpisodeView, scenario: Scenario) -> tuple[Float[Tensor, "N T D"], Float[Tensor, "N T A"]]:
    """States and actions of T driven steps in the frame of the model (D and A of its dynamics)."""
    dynamics = POINT_MASS_1D if isinstance(scenario.group, CarFollowing) else DUBINS
    states = drive_of(view, scenario).state.transpose(0, 1).float()
    return states[:, :-1], dynamics.inverse(states[:, :-1], states[:, 1:], scenario.step)
