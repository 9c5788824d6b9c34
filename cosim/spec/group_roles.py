"""The roles of a group's vehicles, and what may be said about them in a scenario."""

from collections.abc import Iterable, Sequence

from cosim.spec.perturbations import Perturbation, RemoveThird

USUAL_SIZE = 3  # vehicles of a group


def check_roles(size: int, driven: Sequence[int], edges: Iterable[str], perturbations: Sequence[Perturbation]) -> None:
    """Raise `ValueError` where a role that is `driven`, or in one of the `edges` ("1->0"), is none of `size` vehicles.

    Also where vehicle 2 is to be removed from a group of another size than three.
    """
    if len(set(driven)) < len(driven):
        raise ValueError(f"driven is {list(driven)}, expected each role once")
    if max(driven) >= size - 1:
        raise ValueError(f"driven is {list(driven)}, expected roles from 0 to {size - 2}; the leader is {size - 1}")
    for pair in edges:
        if max(int(pair[0]), int(pair[-1])) >= size:
            raise ValueError(f"graph.edges has {pair!r}, expected vehicles from 0 to {size - 1}")
    if size != USUAL_SIZE and any(isinstance(change, RemoveThird) for change in perturbations):
        raise ValueError(
            f"perturbations has remove_third and group.size is {size}, expected a group of three vehicles, or other"
            " perturbations"
        )
