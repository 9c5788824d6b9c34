"""Contacts of the groups of a round, from the take-over until AFTERMATH after each group's own hand-back."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Int

from cosim.measures.collision_detection import overlapping_pairs
from cosim.spec.scenario import AFTERMATH
from cosim.world.episode import CUTTER, OTHER, Contact
from cosim.world.snapshot import Snapshot, rows_of

SAME_PLACE = 50.0  # [m] along the road, beyond which vehicles in one place of the plane are on different levels


def contacts_of(
    trace: Sequence[Snapshot],
    names: Sequence[Mapping[str, str]],
    ends: Sequence[float],
    touching: Sequence[Int[np.ndarray, "_ 2"]] | None = None,
) -> list[tuple[Contact, ...]]:
    """The contacts of every group in the order of time; every pair of vehicles once, at its first contact.

    `trace` are the snapshots after the take-over. `names` gives, for each group, the names by vehicle id that
    `Contact.who` uses: the roles of the members, and CUTTER for a neighbour that was made to cut in. Each contact of a
    group involves at least one member. `ends` [s] are the hand-backs. `touching` is what `touching_pairs` gives for the
    members in each snapshot, where that is known already.
    """
    members = [{vehicle for vehicle, name in of.items() if name != CUTTER} for of in names]
    if touching is None:
        everyone = set().union(*members)
        touching = [touching_pairs(now, rows_of(now.ids, everyone)) for now in trace]
    found: list[dict[frozenset[str], Contact]] = [{} for _ in names]
    for before, now, hits in zip((trace[0], *trace), trace, touching, strict=False):
        if not len(hits):
            continue
        for pair in sorted({tuple(sorted(hit)) for hit in hits.tolist()}):
            vehicles = frozenset(now.ids[row] for row in pair)
            for g, end in enumerate(ends):
                if vehicles & members[g] and vehicles not in found[g] and now.time <= end + AFTERMATH + 1e-6:
                    found[g][vehicles] = _contact(before, now, pair, names[g], end)
    return [tuple(of.values()) for of in found]


def touching_pairs(now: Snapshot, rows: Int[np.ndarray, " R"]) -> Int[np.ndarray, "P 2"]:
    """Pairs of rows of vehicles in contact, the first one among `rows`.

    Where a road passes over itself, vehicles far apart along it do not touch.
    """
    hits = overlapping_pairs(now.xy, now.heading, now.length, now.width, rows)
    if not len(hits):
        return hits
    one, other = hits[:, 0], hits[:, 1]
    near = np.abs(now.s[one] - now.s[other]) <= now.length[one] + now.length[other] + SAME_PLACE
    return hits if near.all() else hits[near]


def _contact(before: Snapshot, now: Snapshot, pair: tuple[int, ...], names: Mapping[str, str], end: float) -> Contact:
    """The contact of the vehicles in two rows of `now`.

    Which of both was farther back is read one step earlier: within a step, a fast vehicle can pass the other's front.
    """
    ids = [now.ids[row] for row in pair]
    at = before if set(ids) <= before.row_of.keys() else now
    rear, ahead = (now.row_of[vehicle] for vehicle in sorted(ids, key=lambda name: (at.s[at.row_of[name]], name)))
    velocity = now.v[[rear, ahead]] * np.array([np.cos(now.heading), np.sin(now.heading)])[:, [rear, ahead]]
    return Contact(
        time=now.time,
        vehicles=(now.ids[rear], now.ids[ahead]),
        who="→".join(names.get(now.ids[row], OTHER) for row in (rear, ahead)),
        speed_difference=float(np.linalg.norm(velocity[:, 0] - velocity[:, 1])),
        after_hand_back=now.time > end + 1e-6,
    )
