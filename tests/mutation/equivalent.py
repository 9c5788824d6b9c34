"""Mutants that change nothing that anybody could see, each with the reason.

They count neither as noticed nor as not noticed.
"""

SAME_VALUE = "where the condition is not met, the other branch gives the same value; the condition saves time"
EMPTY = "without any hit the loop has nothing to do, and the index gives an empty array"

EQUIVALENT: dict[str, str] = {
    "cosim.world.contacts: contacts_of: if not len(hits):: if not len(hits): → never": EMPTY,
    "cosim.world.contacts: touching_pairs: return hits if near.all() else hits[near]:"
    " hits if near.all() else hits[near] → never": SAME_VALUE,
    "cosim.world.break_ups: _earlier_d: if before.ids == now.ids:: if before.ids == now.ids: → never": SAME_VALUE,
    "gri.storage.whole_files: _sync: if folder:  # Windows opens no folders: if folder: → never": "for Windows only",
}
"""`Mutant.name` -> why the program does the same."""
