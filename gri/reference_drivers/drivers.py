"""The reference drivers: which situations they see as a risk, and how hard they want to brake then.

Sources: UN Regulation 157 (ALKS), 01 series, Amendment 4 (E/ECE/TRANS/505/Rev.3/Add.156), paragraph 5.2.5.2 and
Annex 3; Mattas et al. (2020) for the fuzzy surrogate safety metrics; Shalev-Shwartz et al. (2017) for RSS. All
functions are elementwise: arrays of one shape in, arrays of that shape out, in SI units.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

GREATEST_BRAKING = 0.774 * 9.81  # [m/s²], Annex 3: 0.774 g
JERK = 12.65  # [m/s³]: 0.774 g within 0.6 s
STEP_OF_CLOCK = 0.1  # [s], what the criteria of r157 and fsm allow for the discrete clock


class DriverName(StrEnum):
    """Names of the reference drivers, as in YAML files and tables."""

    R157 = "r157"
    CAREFUL_HUMAN = "careful_human"
    CAREFUL_HUMAN_WANDERING = "careful_human_wandering"
    FSM = "fsm"
    RSS = "rss"


@dataclass(frozen=True)
class Situation:
    """A driver (the ego) and another vehicle; distances in m, speeds in m/s.

    `centres` is the distance along the road from the ego's centre to the other's, below 0 where the other is farther
    back. `gap` is the net distance along the road, `side` across it; both are below 0 where the vehicles overlap in
    that direction. `lengths` is the sum of both lengths. `approach` is the other's lateral speed towards the ego's
    lane, and `wandered` how far its centre has left the centre of its own lane towards the ego's. `a` [m/s²] is the
    ego's acceleration in the last step.
    """

    centres: Float[np.ndarray, "*batch"]
    gap: Float[np.ndarray, "*batch"]
    side: Float[np.ndarray, "*batch"]
    lengths: Float[np.ndarray, "*batch"]
    v: Float[np.ndarray, "*batch"]
    v_other: Float[np.ndarray, "*batch"]
    approach: Float[np.ndarray, "*batch"]
    wandered: Float[np.ndarray, "*batch"]
    a: Float[np.ndarray, "*batch"]

    @property
    def ahead(self) -> Bool[np.ndarray, "*batch"]:
        """Whether the other's centre is not behind the ego's; only then can braking help."""
        return self.centres >= 0

    @property
    def ttc(self) -> Float[np.ndarray, "*batch"]:
        """|net gap| over |closing speed| [s]; infinite at equal speeds."""
        return _ratio(np.abs(self.gap), np.abs(self.v - self.v_other))


@dataclass(frozen=True)
class Judgement:
    """Whether a driver sees a risk, and the deceleration it then wants [m/s²].

    `settled` is where the other is no cut-in any more but a vehicle ahead (`CarefulHuman`).
    """

    risk: Bool[np.ndarray, "*batch"]
    braking: Float[np.ndarray, "*batch"]
    settled: Bool[np.ndarray, "*batch"]


@runtime_checkable
class ReferenceDriver(Protocol):
    """How a driver judges situations, and how it gets from there to the brake."""

    @property
    def name(self) -> DriverName: ...

    @property
    def judging(self) -> float:
        """Time for which a risk must last before it counts [s]."""
        ...

    @property
    def reaction(self) -> float:
        """Time from the risk to the brake [s]."""
        ...

    @property
    def release(self) -> float:
        """Deceleration during the reaction [m/s²]."""
        ...

    @property
    def jerk(self) -> float:
        """Greatest increase of the deceleration [m/s³]."""
        ...

    def judge(self, now: Situation) -> Judgement: ...


@dataclass(frozen=True)
class R157:
    """Paragraph 5.2.5.2 as a driver: 0.35 s after the lane intrusion it brakes with 6 m/s².

    A collision must be avoided if TTC > v_rel/(2·6 m/s²) + 0.35 s at the intrusion. The intrusion is where 0.5 m are
    left between the sides: with lanes of 3.5 m and cars of 1.9 m, 0.3 m beyond the lane marking.
    """

    name: DriverName = DriverName.R157
    judging: float = 0.0
    reaction: float = 0.35
    release: float = 0.0
    jerk: float = np.inf
    braking: float = 6.0
    """[m/s²]."""
    intrusion: float = 0.5
    """Lateral distance of the vehicles at the lane intrusion [m]."""

    def judge(self, now: Situation) -> Judgement:
        """Risk where the other intrudes and TTC ≤ Δv/12 + 0.35 s + one step of the clock."""
        critical = (now.v - now.v_other) / (2 * self.braking) + self.reaction + STEP_OF_CLOCK
        risk = now.ahead & (now.side <= self.intrusion) & (now.ttc <= critical)
        return Judgement(risk, np.full(risk.shape, self.braking), np.zeros_like(risk))


@dataclass(frozen=True)
class CarefulHuman:
    """The competent and careful human driver of Annex 3: 0.75 s to the brake, then 0.774 g within 0.6 s.

    Two variants. `wandering` follows the annex: the other is perceived once its centre is more than 0.375 m off its
    lane's centre, is judged for 0.4 s, and is a risk where TTC ≤ 2 s. Without it, which is what public simulators
    compare, a risk is seen only once the cars overlap sideways. In both a case is settled, without a collision, where
    they overlap sideways and TTC > 2 s.
    """

    wandering: bool = False
    reaction: float = 0.75
    release: float = 0.4
    jerk: float = JERK
    critical_ttc: float = 2.0
    """[s]."""
    perceived: float = 0.375
    """Distance from the lane's centre at which a cut-in is perceived [m]."""

    @property
    def name(self) -> DriverName:
        return DriverName.CAREFUL_HUMAN_WANDERING if self.wandering else DriverName.CAREFUL_HUMAN

    @property
    def judging(self) -> float:
        """0.4 s in the variant of the annex."""
        return 0.4 if self.wandering else 0.0

    def judge(self, now: Situation) -> Judgement:
        """Risk where a perceived vehicle ahead has TTC ≤ 2 s."""
        entered, critical = now.ahead & (now.side <= 0), now.ttc <= self.critical_ttc
        near = entered | (now.ahead & (now.wandered > self.perceived)) if self.wandering else entered
        return Judgement(near & critical, np.full(near.shape, GREATEST_BRAKING), entered & ~critical)


@dataclass(frozen=True)
class FuzzySafety:
    """The fuzzy surrogate safety metrics (FSM) of Annex 3: brakes the harder the less safe it is, and early.

    The proactive metric grades the distance, the critical one what is left after the reaction with the present
    acceleration. A vehicle beside the lane counts only if it can get there before the ego has passed.
    """

    name: DriverName = DriverName.FSM
    judging: float = 0.0
    reaction: float = 0.75
    release: float = 0.0
    jerk: float = JERK
    comfortable: float = 4.0
    """b_comf [m/s²]."""
    greatest: float = 6.0
    """b_max [m/s²]."""
    other_greatest: float = 7.0
    """b_c,max, the hardest braking of the other [m/s²]."""
    margin: float = 2.0
    """d_1 [m]."""

    def judge(self, now: Situation) -> Judgement:
        """Deceleration CFS·(b_max − b_comf) + b_comf where CFS > 0, else PFS·b_comf; a risk where either is above 0."""
        proactive, critical = self.proactive(now), self.critical(now)
        until_beside = _ratio(now.side, now.approach)
        until_passed = _ratio(now.gap + now.lengths, now.v - now.v_other)
        enters = (now.side <= 0) | ((now.approach > 0) & (until_beside <= until_passed + STEP_OF_CLOCK))
        wanted = np.where(
            critical > 0,
            critical * (self.greatest - self.comfortable) + self.comfortable,
            proactive * self.comfortable,
        )
        risk = now.ahead & enters & (proactive + critical > 0)
        return Judgement(risk, np.minimum(wanted, GREATEST_BRAKING), np.zeros_like(risk))

    def proactive(self, now: Situation) -> Float[np.ndarray, "*batch"]:
        """PFS: 0 above u·τ + u²/(2 b_comf) − u_c²/(2 b_c,max) + d_1, 1 below u·τ + u²/(2 b_max) − u_c²/(2 b_c,max).

        The distance counts less d_1.
        """
        common = now.v * self.reaction - now.v_other**2 / (2 * self.other_greatest)
        safe = common + now.v**2 / (2 * self.comfortable) + self.margin
        return _graded(now.gap - self.margin, safe, common + now.v**2 / (2 * self.greatest))

    def critical(self, now: Situation) -> Float[np.ndarray, "*batch"]:
        """CFS from u' = u + a'·τ with a' = max(a, −b_comf), and the distance ((u + u')/2 − u_c)·τ of the reaction.

        If u' ≥ u_c: 0 above that distance + (u' − u_c)²/(2 b_comf), 1 below the same with b_max. Else the ego gets as
        slow as the other within τ: 1 below (u − u_c)²/(2 |a|). Always 0 if u ≤ u_c.
        """
        a = np.maximum(now.a, -self.comfortable)
        later = now.v + a * self.reaction
        reacting = (now.v + a * self.reaction / 2 - now.v_other) * self.reaction
        excess = (later - now.v_other) ** 2
        still_closing = _graded(
            now.gap, reacting + excess / (2 * self.comfortable), reacting + excess / (2 * self.greatest)
        )
        slowed = now.gap < _ratio((now.v - now.v_other) ** 2, np.abs(2 * now.a))
        return np.where(now.v <= now.v_other, 0.0, np.where(later < now.v_other, slowed, still_closing))


@dataclass(frozen=True)
class Rss:
    """Responsibility-sensitive safety: a risk where the distances along and across the road are both undercut.

    The reaction time is ρ. Both vehicles accelerate with a_max and brake with d_max; across the road both are 1 m/s².
    """

    name: DriverName = DriverName.RSS
    judging: float = 0.0
    reaction: float = 0.75
    release: float = 0.0
    jerk: float = JERK
    acceleration: float = 3.0
    """a_max [m/s²]."""
    braking: float = 6.0
    """d_max [m/s²]."""
    lateral_margin: float = 0.3
    """[m]."""

    def judge(self, now: Situation) -> Judgement:
        """Risk where gap and lateral distance are below the safe ones."""
        risk = now.ahead & (now.gap < self.along(now.v, now.v_other)) & (now.side < self.across(now.approach))
        return Judgement(risk, np.full(risk.shape, GREATEST_BRAKING), np.zeros_like(risk))

    def along(
        self, v: Float[np.ndarray, "*batch"], v_other: Float[np.ndarray, "*batch"]
    ) -> Float[np.ndarray, "*batch"]:
        """d = v·ρ + a_max·ρ²/2 + (v + ρ·a_max)²/(2 d_max) − u_c²/(2 d_max) [m]; below 0 behind a much faster one."""
        accelerated = v + self.reaction * self.acceleration
        during = v * self.reaction + self.acceleration * self.reaction**2 / 2
        return during + accelerated**2 / (2 * self.braking) - v_other**2 / (2 * self.braking)

    def across(self, approach: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """d = 0.3 m + |(2c + ρ)·ρ/2| + (c + ρ)²/2 [m] with c = |lateral speed|."""
        c = np.abs(approach)
        return self.lateral_margin + np.abs((2 * c + self.reaction) * self.reaction / 2) + (c + self.reaction) ** 2 / 2


DRIVERS: dict[DriverName, ReferenceDriver] = {
    driver.name: driver for driver in (R157(), CarefulHuman(), CarefulHuman(wandering=True), FuzzySafety(), Rss())
}
"""The reference drivers by name, with the parameters of their sources."""


def _graded(
    value: Float[np.ndarray, "*batch"], none: Float[np.ndarray, "*batch"], whole: Float[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch"]:
    """0 above `none`, 1 below `whole`, linear between them."""
    return np.where(value > none, 0.0, np.where(value < whole, 1.0, _ratio(value - none, whole - none)))


def _ratio(a: Float[np.ndarray, "*batch"], b: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """a/b without warnings; infinite or NaN where b is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return a / b
