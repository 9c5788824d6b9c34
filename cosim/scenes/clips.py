"""Three vehicles cut out of a tape, and what SUMO says of them in the form that labels are made from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cosim.labels import NOBODY, Told
from cosim.scenes.rules import Kind
from cosim.scenes.tape import COLUMN, Moment, Tape
from cosim.scenes.windows import Window, rows_through
from cosim.snapshot import Character


@dataclass(frozen=True)
class Clip:
    """A candidate that was seen all through; one moment more than the scene has steps."""

    window: Window
    time: float
    """Of step 0 [s]."""
    characters: tuple[Character, ...]
    values: Float[np.ndarray, "3 M F"]
    """Columns of the tape."""
    behind: Float[np.ndarray, "3 M"]
    """Speed the car-following models allow behind the leaders; inf where that says nothing about the three."""

    @property
    def speeds(self) -> Float[np.ndarray, "3 M"]:
        """[m/s]"""
        return self.values[..., COLUMN["v"]]

    @property
    def kind(self) -> Kind:
        return self.window.kind


def cut(window: Window, tape: Tape, steps: int) -> Clip | None:
    """The clip of a window whose last moment, one after its T steps, is the newest; None where somebody was away."""
    moments = [moment for moment in tape.moments if moment.index >= window.begin]
    assert len(moments) == steps + 1, f"got {len(moments)} moments, wanted {steps + 1}"
    rows = rows_through(moments, window.vehicles)
    if rows is None:
        return None
    tape.settle()
    values = np.stack([moment.values[rows[:, t]] for t, moment in enumerate(moments)], 1)
    ids = [moments[0].ids[row] for row in rows[:, 0]]
    characters = tuple(tape.world.character(vehicle) for vehicle in ids)
    return Clip(window, moments[0].time, characters, values, _behind(tape, window, moments, ids, values))


def _behind(
    tape: Tape, window: Window, moments: Sequence[Moment], ids: list[str], values: np.ndarray
) -> Float[np.ndarray, "3 M"]:
    """Asks the car-following models, for those steps only at which a label may depend on it."""
    leader, asker = (values[..., COLUMN[name]].astype(int) for name in ("leader", "asker"))
    concerned = np.isin(leader, window.vehicles) | (np.isin(asker, window.vehicles) & (leader != NOBODY))
    behind = np.full(leader.shape, np.inf)
    braking: dict[int, float] = {}
    for j, t in np.argwhere(concerned).tolist():
        number, moment = int(leader[j, t]), moments[t]
        row = moment.row.get(number)
        if row is None:  # beyond the stretch: nobody can say that it was not the leader who slowed it
            behind[j, t] = 0.0
            continue
        if number not in braking:
            braking[number] = tape.world.braking(moment.ids[row])
        v, gap = values[j, t, COLUMN["v"]], values[j, t, COLUMN["gap"]]
        v_leader = moment.values[row, COLUMN["v"]]
        behind[j, t] = tape.world.follow_speed(ids[j], float(v), float(gap), float(v_leader), braking[number])
    return behind


def told_of(clips: Sequence[Clip], step: float, every: int) -> Told:
    """What SUMO says of the vehicles of clips of one kind, for `cosim.labels`."""
    values = np.stack([clip.values[:, :-1] for clip in clips])
    v, limit, leader, asker, cut_in = (values[..., COLUMN[n]] for n in ("v", "limit", "leader", "asker", "cut"))
    factor, top, acceleration, imperfection = (
        np.array([[getattr(c, name) for c in clip.characters] for clip in clips])[..., None]
        for name in ("speed_factor", "max_speed", "acceleration", "imperfection")
    )
    return Told(
        vehicle=np.array([clip.window.vehicles for clip in clips]),
        v=v,
        v_next=values[..., COLUMN["v_next"]],
        free=np.minimum(v + acceleration * step, np.minimum(limit * factor, top)),
        behind=np.stack([clip.behind[:, :-1] for clip in clips]),
        noise=np.broadcast_to(imperfection * acceleration, v.shape),
        leader=leader.astype(int),
        asker=asker.astype(int),
        gave_way=values[..., COLUMN["gave_way"]] > 0,
        cut=cut_in.astype(int),
        room=values[..., COLUMN["room"]],
        dt=step,
        every=every,
    )


def tried(clips: Sequence[Clip]) -> tuple[np.ndarray, np.ndarray]:
    """[S, 3, T] Accelerations that the vehicles owe to their leader, and to requests (negative) [m/s²]."""
    values = np.stack([clip.values[:, :-1] for clip in clips])
    return values[..., COLUMN["unled"]], values[..., COLUMN["unasked"]]
