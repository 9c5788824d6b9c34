"""One policy and the vehicles of its share of the traffic: which speed each of them is to have after the next step."""

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from cosim.loop.own_policy import PolicyFailure
from cosim.loop.pair_policy import PairPolicy
from cosim.loop.policy_runner import LARGEST
from cosim.loop.traffic_history import TrafficHistory
from cosim.sumo.speed_control import DriverLimits
from cosim.world.road_frame import NOMINAL_LENGTH
from gri.core.trajectory import Trajectory

MARGIN = 0.5  # [m] that the last-moment bound keeps free; covers the rounding of braking distances to whole steps
INFER_AT_MOST = 1.0  # [s] between two inferences, at least
NOBODY = -1


def last_moment_speed(
    gap: Float[np.ndarray, " P"], v_ahead: Float[np.ndarray, " P"], braking: Float[np.ndarray, " P"], dt: float
) -> Float[np.ndarray, " P"]:
    """The highest speed [m/s] after the next step from which a vehicle still stops behind the vehicle ahead.

    Both brake with `braking` [m/s²] from now on, the follower after the step. In steps of dt a vehicle needs at most
    v²/(2b) − v·dt/2 + b·dt²/8 to stop, and at least v²/(2b) − v·dt/2 (SUMO: speed first, then position). With the gap
    s, the bound u solves u·dt + u²/(2b) − u·dt/2 = s − MARGIN + v²/(2b) − v·dt/2.
    """
    free = np.maximum(gap - MARGIN + v_ahead * (v_ahead / (2 * braking) - dt / 2).clip(0), 0)
    return braking * (np.sqrt(dt**2 / 4 + 2 * free / braking) - dt / 2)


@dataclass
class Counts:
    """Of one share after the warm-up, in vehicle steps: commanded by the policy; left to SUMO because nobody was ahead,
    or because the vehicle had to change lanes; bounded by the last-moment bound, or by SUMO.
    """

    commanded: int = 0
    nobody_ahead: int = 0
    lane_change: int = 0
    last_moment: int = 0
    bounded_by_sumo: int = 0
    largest_error: float = 0.0
    """[m/s] by which a vehicle was faster than commanded."""
    inferences: int = 0
    not_followed: int = 0
    """Inferences by which the vehicle does not react to the vehicle ahead."""

    @property
    def total(self) -> int:
        return self.commanded + self.nobody_ahead + self.lane_change


@dataclass(frozen=True)
class GraphRow:
    """The inferred relation of one pair: the probability that `receiver` reacts to `sender`, the vehicle ahead."""

    time: float
    sender: str
    receiver: str
    follows: float
    unknown: float


@dataclass
class SpeedShare:
    """A policy with its vehicles. `reinfer` [steps] is how often the graph of a pair is inferred again (0: never).

    With `bounded` no speed exceeds the last-moment bound.
    """

    name: str
    policy: PairPolicy
    dt: float
    reinfer: int
    bounded: bool = True
    vehicles: list[str] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    failure: str = ""
    graphs: list[GraphRow] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._tick = max(round(INFER_AT_MOST / self.dt), self.reinfer, 1)  # [steps] between two inferences
        self._scene: dict[str, int] = {}  # number of each vehicle's scene
        self._free: list[int] = []
        self._ahead = np.zeros(0, dtype=int)  # column of the vehicle ahead in the last step, by scene
        self._since = np.zeros(0, dtype=int)  # step at which the scene began
        self._inferred = np.zeros(0, dtype=int)  # step of its last inference, or NOBODY
        self._a = np.zeros(0)  # acceleration that the dynamics gave, by scene; NaN where the measured one counts
        self._facts: dict[str, tuple[float, float]] = {}  # strongest braking [m/s²], minimum gap [m]
        self._arrays: tuple[np.ndarray, ...] | None = None

    def add(self, vehicle: str, limits: DriverLimits, min_gap: float) -> None:
        """Drive this vehicle from now on."""
        if not self._free:
            size = len(self._ahead)
            more = max(size, 32)
            self._ahead, self._since, self._inferred = (
                np.pad(x, (0, more), constant_values=NOBODY) for x in (self._ahead, self._since, self._inferred)
            )
            self._a = np.pad(self._a, (0, more), constant_values=np.nan)
            self._free = [*range(size + more - 1, size - 1, -1)]
        self._scene[vehicle] = scene = self._free.pop()
        self._ahead[scene] = NOBODY
        self._facts[vehicle] = limits.braking, min_gap
        self.vehicles.append(vehicle)
        self._arrays = None

    def remove(self, vehicle: str) -> None:
        """Forget a vehicle that left the net."""
        if vehicle in self._scene:
            self._free.append(self._scene.pop(vehicle))
            self._facts.pop(vehicle)
            self.vehicles.remove(vehicle)
            self._arrays = None

    def _of_vehicles(self) -> tuple[np.ndarray, ...]:
        """Scene, strongest braking and minimum gap of each vehicle."""
        if self._arrays is None:
            facts = np.array([self._facts[vehicle] for vehicle in self.vehicles]).reshape(-1, 2)
            self._arrays = np.array([self._scene[v] for v in self.vehicles], dtype=int), facts[:, 0], facts[:, 1]
        return self._arrays

    def speeds(
        self,
        step: int,
        history: TrafficHistory,
        own: Int[np.ndarray, " V"],
        ahead: Int[np.ndarray, " V"],
        gap: Float[np.ndarray, " V"],
        driven: Bool[np.ndarray, " V"],
    ) -> Float[np.ndarray, " K"]:
        """The commanded speeds [m/s] of the `driven` ones of `vehicles`.

        `own` and `ahead` are columns of the history, `gap` [m] is what SUMO calls the gap: without the minimum gap.
        Raises PolicyFailure.
        """
        scene, braking, min_gap = self._of_vehicles()
        self._ahead[scene[~driven]] = NOBODY
        scene, own, ahead = scene[driven], own[driven], ahead[driven]
        if not len(scene):
            return np.zeros(0)
        braking, gap = braking[driven], gap[driven] + min_gap[driven]
        self._begin(step, history, scene, own, ahead, gap)
        self._infer(step, history, scene, own, ahead, gap)
        v, v_ahead = history.v[own], history.v[ahead]
        a = np.where(np.isnan(self._a[scene]), history.a[own], self._a[scene])
        wished, self._a[scene] = self._after_step(scene, v, a, gap, v_ahead, history.a[ahead])
        if self.bounded:
            bound = last_moment_speed(gap, v_ahead, braking, self.dt)
            over = wished > bound
            self.counts.last_moment += int(over.sum())
            self._a[scene[over]] = np.nan
            wished = np.minimum(wished, bound)
        return wished

    def measured_instead(self, driven: Bool[np.ndarray, " V"], which: Bool[np.ndarray, " K"]) -> None:
        """Use the measured acceleration of these of the driven vehicles, because they did not get their speed."""
        self._a[self._of_vehicles()[0][driven][which]] = np.nan

    def _begin(self, step: int, history: TrafficHistory, scene, own, ahead, gap) -> None:
        """Begin the scenes with another vehicle ahead than in the last step."""
        new = self._ahead[scene] != ahead
        if not new.any():
            return
        begun = scene[new]
        self._a[begun] = np.where(self._ahead[begun] == NOBODY, np.nan, self._a[begun])
        self._ahead[begun], self._since[begun], self._inferred[begun] = ahead[new], step, NOBODY
        read = self.policy.begin(begun, len(self._ahead))
        if read.any():
            which = np.flatnonzero(new)[read]
            self._read(step, history, scene[which], own[which], ahead[which], gap[which])

    def _infer(self, step: int, history: TrafficHistory, scene, own, ahead, gap) -> None:
        """Infer the graphs that are due, all at once: a call for many pairs costs little more than one for a few."""
        if step % self._tick:
            return
        together = step - self._since[scene] >= self.policy.history_steps - 1
        due = np.flatnonzero(together & ((self._inferred[scene] == NOBODY) | (self.reinfer > 0)))
        if len(due):
            self._read(step, history, scene[due], own[due], ahead[due], gap[due])

    def _read(self, step: int, history: TrafficHistory, scene, own, ahead, gap) -> None:
        """Let the policy read the histories of scenes."""
        self._inferred[scene] = step
        found = self.policy.read(scene, self._history(history, own, ahead, gap), self._tick * self.dt)
        if found is None:
            return
        self.counts.inferences += len(scene)
        self.counts.not_followed += int((found.follows < 0.5).sum())
        names = {column: vehicle for vehicle, column in history.column_of.items()}
        self.graphs += [
            GraphRow(step * self.dt, names[sender], names[receiver], follows, unknown)
            for sender, receiver, follows, unknown in zip(
                ahead.tolist(), own.tolist(), found.follows.tolist(), found.unknown.tolist(), strict=True
            )
        ]

    def _history(self, history: TrafficHistory, own, ahead, gap) -> Trajectory:
        """The states (x, v, a) of both vehicles of each scene; x is counted from the vehicle ahead, now."""
        steps = self.policy.history_steps
        states = np.empty((len(own), 2, steps, 3))
        for place, columns, offset in ((0, own, -gap - NOMINAL_LENGTH), (1, ahead, 0 * gap)):
            x, v = history.past(columns, steps)
            states[:, place, :, 0], states[:, place, :, 1] = x + offset[:, None], v
            states[:, place, :, 2] = np.diff(v, axis=1, prepend=v[:, :1]) / self.dt
        return Trajectory.complete(torch.from_numpy(states.astype(np.float32)), self.dt)

    def _after_step(self, scene, v, a, gap, v_ahead, a_ahead) -> tuple[np.ndarray, np.ndarray]:
        """Speed and acceleration of each vehicle after the next step, by the policy and its dynamics."""
        states = np.stack([np.stack([-gap - NOMINAL_LENGTH, v, a], -1), np.stack([0 * gap, v_ahead, a_ahead], -1)], 1)
        jerk = self.policy.act(scene, states)
        if not (np.isfinite(jerk) & (np.abs(jerk) <= LARGEST)).all():
            wrong = jerk[~(np.isfinite(jerk) & (np.abs(jerk) <= LARGEST))][0]
            raise PolicyFailure(f"act returned the action {wrong}, expected finite numbers of at most {LARGEST:g}")
        following = self.policy.policy.dynamics.step(states[:, 0], jerk[:, None], self.dt)
        stopped = following[:, 1] < 0
        return np.where(stopped, 0.0, following[:, 1]), np.where(stopped, 0.0, following[:, 2])
