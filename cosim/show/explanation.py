"""An episode explained in text, from the graph that the policy inferred and the terms of its reward.

The weighted terms of the reward (gri.rewards.structured) are evaluated on the recorded drive, in the frame of the
model: the node terms of each driven vehicle, and the edge terms of each inferred relation. The largest terms explain
the drive.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cosim.runs.run_tables import read_json
from cosim.show.episode_view import EpisodeView, InferredEdge
from cosim.spec.input_files import checkpoint_path
from cosim.spec.scenario import CarFollowing, Scenario, TrainedPolicy
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
    """The inferred graph, the drive and the largest reward terms of one episode, as text. `run` is the run folder."""
    scenario = read_json(run / "scenario.json", Scenario)
    reward = None
    if isinstance(scenario.policy, TrainedPolicy):
        reward = checkpoint.load_reward(checkpoint_path(scenario.policy.checkpoint))
    lines = [_headline(view), "", *_graph(view)]
    for role in range(2):
        lines += ["", *_drive(view, role)]
        if view.driven[:, role].any() and view.inferred_edges:
            lines += _reasons(view, role, scenario, reward)
    return "\n".join(lines)


def _headline(view: EpisodeView) -> str:
    names = ", ".join(f"{vehicle} ({role})" for role, vehicle in enumerate(view.ids))
    ended = str(view.group["ending"]).replace("_", " ")
    return (
        f"Episode {view.number}: {view.driver} drives a group of the vehicles {names}. Take-over at"
        f" {view.takeover_time:.1f} s; driven for {view.group['drive_duration']:.1f} s; ended by: {ended}."
    )


def _graph(view: EpisodeView) -> list[str]:
    """Every relation that the policy inferred at the take-over, and every later change."""
    if not view.inferred_edges:
        return [f"{view.driver} does not infer a graph."]
    at_first = _at_takeover(view)
    lines = [
        f"{view.ids[e.receiver]} ({e.receiver}) {VERBS.get(e.type, e.type)} {view.ids[e.sender]} ({e.sender})"
        f" (p {e.probability:.2f})."
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
                f" {latest[pair]} to {edge.type} (p {edge.probability:.2f})."
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
        return ["  Its checkpoint has no reward, so there are no reward terms to explain the drive."]
    terms = sorted(terms_of(view, role, scenario, reward), key=lambda term: -term.cost.mean())
    total = sum(float(term.cost.mean()) for term in terms)
    if total < 1e-9:
        return ["  All terms of its reward are zero during the drive."]
    time = view.time[_driven_steps(view)] - view.takeover_time
    lines = []
    for term in terms:
        mean, peak = float(term.cost.mean()), int(term.cost.argmax())
        if mean >= 0.05 * total:
            lines.append(
                f"  {100 * mean / total:.0f} % of its cost: {term.meaning} ({term.group} term {term.name}, mean"
                f" {mean:.3g}, maximum {term.cost[peak]:.3g} after {time[peak]:.1f} s, {term.cost[-1]:.3g} at the end)."
            )
    return lines


def terms_of(view: EpisodeView, role: int, scenario: Scenario, reward: StructuredReward) -> list[Term]:
    """The weighted terms of one vehicle (role 0 or 1) at every driven step, under the graph at the take-over."""
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


def _driven_steps(view: EpisodeView) -> np.ndarray:
    """Rows of the drive except the last one."""
    return np.flatnonzero(view.during_drive)[:-1]


def model_states(view: EpisodeView, scenario: Scenario) -> tuple[Float[Tensor, "3 T D"], Float[Tensor, "3 T A"]]:
    """States and actions of the T driven steps in the frame of the model (D and A of its dynamics).

    In a merge, the heading is that of the path, and y is relative to the lane of the leader at the take-over.
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
