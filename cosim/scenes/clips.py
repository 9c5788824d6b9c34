"""Three vehicles cut out of a tape, and what SUMO says of them in the form that labels are made from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from cosim.measures.relation_labels import NOBODY, DriverRecords
from cosim.scenes.candidates import Window, rows_throughout
from cosim.scenes.rules import Kind
from cosim.scenes.trajectory_buffer import COLUMN, BufferedStep, TrajectoryBuffer
from cosim.world.snapshot import DriverParameters


@dataclass(frozen=True)
class Clip:
    """A candidate that was seen all through; one moment more than the scene has steps."""

    window: Window
    time: float
    """Of step 0 [s]."""
    characters: tuple[DriverParameters, ...]
    values: Float[np.ndarray, "3 M F"]
    """Columns of the tape."""
    behind: Float[np.ndarray, "3 M"]
    """Speed the car-following models allow behind the leaders; inf where that says nothing about the three."""
    beside: Float[np.ndarray, "3 M"]
    """The same behind whom they want to change lanes to, where that is one of the three; else inf."""

    @property
    def speeds(self) -> Float[np.ndarray, "3 M"]:
        """[m/s]"""
        return self.values[..., COLUMN["v"]]

    @property
    def kind(self) -> Kind:
        return self.window.kind


def cut(window: Window, tape: TrajectoryBuffer, steps: int) -> Clip | None:
    """The clip of a window whose last moment, one after its T steps, is the newest; None where somebody was away."""
    moments = [moment for moment in tape.moments if moment.index >= window.begin]
    assert len(moments) == steps + 1, f"got {len(moments)} moments, wanted {steps + 1}"
    rows = rows_throughout(moments, window.vehicles)
    if rows is None:
        return None
    tape.settle()
    values = np.stack([moment.values[rows[:, t]] for t, moment in enumerate(moments)], 1)
    limits = np.array([moment.limits for moment in moments])
    values[..., COLUMN["limit"]] = limits[np.arange(len(moments)), values[..., COLUMN["lane"]].astype(int)]
    if tape.every == 1:
        values[:, :-1, COLUMN["v_next"]] = values[:, 1:, COLUMN["v"]]
    ids = [moments[0].ids[row] for row in rows[:, 0]]
    characters = tuple(tape.world.drivers.character(vehicle) for vehicle in ids)
    leader, asker, target = (values[..., COLUMN[name]].astype(int) for name in ("leader", "asker", "target"))
    led, after, wanted = ((whom[..., None] == window.vehicles).any(-1) for whom in (leader, asker, target))
    concerned = led | ((after | wanted) & (leader != NOBODY))
    behind = _allowed(tape, moments, ids, values, "gap", np.where(concerned, leader, NOBODY))
    beside = _allowed(tape, moments, ids, values, "target_gap", np.where(wanted, target, NOBODY))
    return Clip(window, moments[0].time, characters, values, behind, beside)


def _allowed(
    tape: TrajectoryBuffer,
    moments: Sequence[BufferedStep],
    ids: list[str],
    values: np.ndarray,
    gap: str,
    whom: Int[np.ndarray, "3 M"],
) -> Float[np.ndarray, "3 M"]:
    """Asks the car-following models, for those steps only at which a label may depend on it; inf elsewhere."""
    allowed = np.full(whom.shape, np.inf)
    braking: dict[int, float] = {}
    for j, t in np.argwhere(whom != NOBODY).tolist():
        number, moment = int(whom[j, t]), moments[t]
        row = moment.row.get(number)
        if row is None:  # beyond the stretch: nobody can say that it was not the leader who slowed it
            allowed[j, t] = 0.0
            continue
        if number not in braking:
            braking[number] = tape.world.drivers.braking(moment.ids[row])
        v, room, v_leader = values[j, t, COLUMN["v"]], values[j, t, COLUMN[gap]], moment.values[row, COLUMN["v"]]
        allowed[j, t] = tape.world.drivers.follow_speed(ids[j], float(v), float(room), float(v_leader), braking[number])
    return allowed


def driver_records_of(clips: Sequence[Clip], step: float, every: int) -> DriverRecords:
    """What SUMO says of the vehicles of clips of one kind, for `cosim.measures.relation_labels`."""
    values = np.stack([clip.values[:, :-1] for clip in clips])
    v, limit = values[..., COLUMN["v"]], values[..., COLUMN["limit"]]
    leader, asker, target, cut_in = (
        values[..., COLUMN[name]].astype(int) for name in ("leader", "asker", "target", "cut")
    )
    factor, top, acceleration, imperfection = (
        np.array([[getattr(c, name) for c in clip.characters] for clip in clips])[..., None]
        for name in ("speed_factor", "max_speed", "acceleration", "imperfection")
    )
    return DriverRecords(
        vehicle=np.array([clip.window.vehicles for clip in clips]),
        v=v,
        v_next=values[..., COLUMN["v_next"]],
        free=np.minimum(v + acceleration * step, np.minimum(limit * factor, top)),
        behind=np.stack([clip.behind[:, :-1] for clip in clips]),
        noise=np.broadcast_to(imperfection * acceleration, v.shape),
        beside=np.stack([clip.beside[:, :-1] for clip in clips]),
        leader=leader,
        asker=asker,
        target=target,
        gave_way=values[..., COLUMN["gave_way"]] > 0,
        cut=cut_in,
        room=values[..., COLUMN["room"]],
        dt=step,
        every=every,
    )


def tried(clips: Sequence[Clip]) -> tuple[np.ndarray, np.ndarray]:
    """[S, 3, T] Accelerations that the vehicles owe to their leader, and to requests (negative) [m/s²]."""
    values = np.stack([clip.values[:, :-1] for clip in clips])
    return values[..., COLUMN["unled"]], values[..., COLUMN["unasked"]]
