"""The inferred graphs of many groups, summarised per pair of roles and drawn as SVG."""

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

import numpy as np
import pandas as pd
from jaxtyping import Float

from cosim.world.outcome_columns import MOST_ROLES

LEFT, STEP, BOTTOM = 60.0, 65.0, 20.0  # places of the roles in the drawing; the road goes up


@dataclass(frozen=True)
class PairSummary:
    """One pair over many groups: its most frequent type, the share of groups with it, and its mean probability."""

    sender: int
    receiver: int
    type: str
    share: float
    probability: float


def pairs_of(groups: pd.DataFrame) -> dict[tuple[int, int], PairSummary]:
    """Summary of each pair of roles, over the groups whose driver infers a graph; empty without such groups."""
    return {(pair.sender, pair.receiver): pair for pair in _pairs(groups)}


def _pairs(groups: pd.DataFrame) -> Iterator[PairSummary]:
    size = sum(f"vehicle_{role}" in groups for role in range(MOST_ROLES))
    for sender in range(size):
        for receiver in range(size):
            column = f"edge_{sender}_{receiver}"
            if sender == receiver or column not in groups or groups[column].isna().all():
                continue
            known = groups[groups[column].notna()]
            kind = str(known[column].mode().iloc[0])
            same = known[known[column] == kind]
            yield PairSummary(sender, receiver, kind, len(same) / len(known), float(same[f"{column}_p"].mean()))


def drawing(pairs: dict[tuple[int, int], PairSummary]) -> str:
    """SVG of the most frequent graph: an arrow from sender to receiver, labelled with the reaction of the receiver."""
    found = ", ".join(f"{p.receiver} {p.type.replace('_', ' ')} {p.sender}" for p in pairs.values() if p.type != "none")
    about = escape(f"most frequent inferred graph: {found or 'no relation'}", quote=True)
    size = max((role for pair in pairs for role in pair), default=2) + 1
    places = [(LEFT, BOTTOM + STEP * (size - 1 - role)) for role in range(size)]
    height = STEP * size - BOTTOM
    parts = [f'<svg viewBox="0 0 190 {height:.0f}" width="220" role="img" aria-label="{about}">']
    for pair in pairs.values():
        if pair.type != "none":
            parts.append(_arrow(pair, np.array(places)))
    for role, (x, y) in enumerate(places):
        parts.append(f'<circle cx="{x}" cy="{y}" r="13" fill="var(--v{role})"/>')
        parts.append(f'<text x="{x}" y="{y + 4}" text-anchor="middle" font-size="12" fill="#fff">{role}</text>')
    return "".join([*parts, "</svg>"])


def _arrow(pair: PairSummary, places: Float[np.ndarray, "N 2"]) -> str:
    start, end = places[pair.sender], places[pair.receiver]
    along = (end - start) / np.linalg.norm(end - start)
    side = np.array([along[1], -along[0]]) * (18 + 17 * (abs(pair.sender - pair.receiver) - 1))
    a, b, middle = start + 14 * along + side / 3, end - 16 * along + side / 3, (start + end) / 2 + side * 1.5
    tip = (b - middle) / np.linalg.norm(b - middle)
    wing = np.array([tip[1], -tip[0]])
    head = " ".join(f"{x:.1f},{y:.1f}" for x, y in (b, b - 7 * tip + 3.5 * wing, b - 7 * tip - 3.5 * wing))
    text = middle * 0.55 + (start + end) / 2 * 0.45
    anchor = "start" if side[0] > 0 else "end"
    name = escape(pair.type.replace("_", " "))
    colour = f"var(--{pair.type})"
    return (
        f'<path d="M{a[0]:.1f} {a[1]:.1f}Q{middle[0]:.1f} {middle[1]:.1f} {b[0]:.1f} {b[1]:.1f}" fill="none"'
        f' stroke="{colour}" stroke-width="2"/><polygon points="{head}" fill="{colour}"/>'
        f'<text x="{text[0] + (6 if side[0] > 0 else -6):.1f}" y="{text[1] + 4:.1f}" text-anchor="{anchor}"'
        f' font-size="11" fill="{colour}">{name} {100 * pair.share:.0f} %</text>'
    )
