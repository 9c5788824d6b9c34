"""An episode in words, computed from the policy's own graph and the terms of its own reward; nothing is made up.

The reward's weighted terms (gri.rewards.structured) are taken on the recorded drive, in the model's frame: what a
vehicle paid to itself, and what each relation that the policy believed in cost it. The largest are what the drive was
about.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cosim.show.episode_view import Belief, View
from cosim.spec.input_files import checkpoint_path
from cosim.spec.scenario import CarFollowing, Scenario, Trained
from cosim.world.road_frame import model_offsets
from gri import checkpoint
from gri.core.dynamics import DUBINS, POINT_MASS_1D
from gri.core.graph import EdgeType
from gri.rewards.structured import StructuredReward

VERBS = {"follow": "follows", "yield": "yields to", "cut_in": "cuts in ahead of"}
MEANING = {
    ("node", "speed"): "keeping the desired speed",
    ("node", "acceleration"): "driving without acceleration",
    ("node", "jerk"): "driving without jerk",
    ("node", "heading"): "staying parallel to the road",
    ("node", "yaw_rate"): "not turning",
    ("node", "yaw_acceleration"): "not jerking the wheel",
    ("node", "lane"): "being in the target lane",
    ("follow", "idm"): "keeping the headway of the intelligent driver model",
    ("follow", "dist"): "not coming too close",
    ("follow", "lat"): "being in the same lane",
    ("yield", "yield"): "leaving the headway that yielding asks for",
    ("yield", "dist"): "not coming too close",
    ("cut_in", "goal"): "getting ahead by the headway that cutting in asks for",
    ("cut_in", "dist"): "not coming too close",
}


@dataclass(frozen=True)
class Term:
    """One weighted term of the reward along a drive [T]; what it costs is never negative."""

    group: str  # "node", or the type of the relation
    name: str
    sender: int | None
    cost: Float[np.ndarray, " T"]

    @property
    def meaning(self) -> str:
        words = MEANING.get((self.group, self.name), f"the term {self.name}")
        return words if self.sender is None else f"{words} towards {self.sender}"


def explanation(view: View, run: Path) -> str:
    """What the policy believed and did in one episode of a run folder, as text."""
    scenario = msgspec.json.decode((run / "scenario.json").read_bytes(), type=Scenario)
    reward = None
    if isinstance(scenario.policy, Trained):
        reward = checkpoint.load_reward(checkpoint_path(scenario.policy.checkpoint))
    lines = [_headline(view), "", *_beliefs(view)]
    for role in range(2):
        lines += ["", *_drive(view, role)]
        if view.driven[:, role].any() and view.beliefs:
            lines += _reasons(view, role, scenario, reward)
    return "\n".join(lines)


def _headline(view: View) -> str:
    names = ", ".join(f"{vehicle} ({role})" for role, vehicle in enumerate(view.ids))
    ended = str(view.group["ending"]).replace("_", " ")
    return (
        f"Episode {view.number}: {view.driver} and the vehicles {names}, taken at {view.taken:.1f} s, driven for"
        f" {view.group['drive_duration']:.1f} s; ended by: {ended}."
    )


def _beliefs(view: View) -> list[str]:
    """Every relation the policy went by, and what it changed its mind about."""
    if not view.beliefs:
        return [f"{view.driver} has no notion of a graph."]
    first = min(belief.time for belief in view.beliefs)
    at_first = [belief for belief in view.beliefs if belief.time == first]
    lines = [
        f"{view.ids[b.receiver]} ({b.receiver}) {VERBS.get(b.type, b.type)} {view.ids[b.sender]} ({b.sender})"
        f" (p {b.probability:.2f})."
        for b in at_first
        if b.type != "none"
    ] or ["Nobody reacts to anybody."]
    unsure = min((b for b in at_first if b.type == "none"), key=lambda b: b.probability, default=None)
    if unsure is not None:
        lines.append(
            f"No other relation; least sure of {unsure.sender} on {unsure.receiver} (p {unsure.probability:.2f})."
        )
    return lines + _changes(view.beliefs, view.taken)


def _changes(beliefs: Sequence[Belief], taken: float) -> list[str]:
    latest: dict[tuple[int, int], str] = {}
    lines = []
    for belief in sorted(beliefs, key=lambda belief: belief.time):
        pair = (belief.sender, belief.receiver)
        if latest.get(pair, belief.type) != belief.type:
            lines.append(
                f"{belief.time - taken:.1f} s after the take-over it takes {belief.sender} on {belief.receiver} for"
                f" {belief.type} (p {belief.probability:.2f}), no longer for {latest[pair]}."
            )
        latest[pair] = belief.type
    return lines


def _drive(view: View, role: int) -> list[str]:
    """What a vehicle did from the take-over to the end of the drive."""
    way = view.during_drive
    v, a, gap = view.feature("v")[way, role], view.feature("a")[way, role], view.gap[way, role]
    time = view.time[way] - view.taken
    hardest = int(a.argmin())
    who = "driven by the policy" if view.driven[:, role].any() else "driven by SUMO"
    line = f"{view.ids[role]} ({role}), {who}: {v[0]:.1f} m/s at the take-over, {v[-1]:.1f} m/s at the end"
    if np.isfinite(gap).all():
        line += f"; net gap {gap[0]:.1f} m, then {gap[-1]:.1f} m,"
        line += f" smallest {gap.min():.1f} m after {time[gap.argmin()]:.1f} s"
    return [f"{line}; strongest deceleration {max(-a[hardest], 0.0):.1f} m/s² after {time[hardest]:.1f} s."]


def _reasons(view: View, role: int, scenario: Scenario, reward: StructuredReward | None) -> list[str]:
    """The reward's largest terms for one vehicle, and when they counted most."""
    if reward is None:
        return ["  Its checkpoint has no reward, so nothing says why."]
    terms = sorted(terms_of(view, role, scenario, reward), key=lambda term: -term.cost.mean())
    total = sum(float(term.cost.mean()) for term in terms)
    if total < 1e-9:
        return ["  Its reward asked for nothing that it did not have."]
    time = view.time[_driven_steps(view)] - view.taken
    lines = []
    for term in terms:
        mean, peak = float(term.cost.mean()), int(term.cost.argmax())
        if mean >= 0.05 * total:
            lines.append(
                f"  {100 * mean / total:.0f} % of what it paid: {term.meaning} ({term.group} term {term.name}, mean"
                f" {mean:.3g}, at most {term.cost[peak]:.3g} after {time[peak]:.1f} s, {term.cost[-1]:.3g} at the end)."
            )
    return lines


def terms_of(view: View, role: int, scenario: Scenario, reward: StructuredReward) -> list[Term]:
    """The weighted terms of one vehicle under the graph the policy went by, at every driven step."""
    state, action = _model(view, scenario)
    own = state[role]
    columns = reward.node_features(own, action[role]) * reward.weights("node")
    terms = [Term("node", name, None, columns[:, k].numpy()) for k, name in enumerate(reward.names("node"))]
    for belief in _in_force(view):
        if belief.receiver == role and belief.type in {str(kind) for kind in reward.terms.edge}:
            kind = EdgeType(belief.type)
            columns = reward.edge_features(kind, state[belief.sender], own) * reward.weights(kind)
            terms += [
                Term(belief.type, name, belief.sender, columns[:, k].numpy())
                for k, name in enumerate(reward.names(belief.type))
            ]
    return terms


def _in_force(view: View) -> list[Belief]:
    """The graph at the take-over."""
    first = min(belief.time for belief in view.beliefs)
    return [belief for belief in view.beliefs if belief.time == first]


def _driven_steps(view: View) -> np.ndarray:
    """Rows of the drive that have a successor in it."""
    return np.flatnonzero(view.during_drive)[:-1]


def _model(view: View, scenario: Scenario) -> tuple[Float[Tensor, "3 T D"], Float[Tensor, "3 T A"]]:
    """States and actions of the drive in the model's frame.

    In a merge the heading is that of the path over the ground, and y counts from the leader's lane at the take-over.
    """
    rows = np.flatnonzero(view.during_drive)
    s, d, v, a = (view.feature(name)[rows] for name in ("s", "d", "v", "a"))
    if isinstance(scenario.group, CarFollowing):
        offset, dynamics = model_offsets(view.length[None])[0], POINT_MASS_1D
        state = np.stack([s + offset, v, a], -1)
    else:
        offset, dynamics = model_offsets(view.length[None], order=(1, 0, 2))[0], DUBINS
        heading = np.arctan2(np.gradient(d, axis=0), np.maximum(np.gradient(s, axis=0), 1e-6))
        turn = np.gradient(heading, scenario.step, axis=0)
        state = np.stack([s + offset, d - d[0, 2], v, heading, a, turn], -1)
    states = torch.from_numpy(state).float().transpose(0, 1)
    states[..., 0] -= states[2:, :1, 0].clone()
    return states[:, :-1], dynamics.inverse(states[:, :-1], states[:, 1:], scenario.step)
