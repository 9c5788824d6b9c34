"""How many differences of the released stress tests stay significant with clusters and with a correction.

The tables of version 0.1 took starts as independent and corrected nothing. This compares their p-values with those of
the same tests over seeds, before and after Benjamini and Hochberg's correction. About a minute.
"""

from pathlib import Path

import pandas as pd

from cosim.stress.estimates import differences
from cosim.world.outcome_columns import with_outcome_columns

RESULTS = Path(__file__).parents[1] / "docs/results"
RENAMED = {"taken_at": "takeover_time", "driven_for": "drive_duration"}
TEST = ["perturbation", "intensity", "policy", "measure"]


def main() -> None:
    """Print one line per released stress test."""
    for folder in sorted(RESULTS.glob("stress_*")):
        rows = with_outcome_columns(pd.read_parquet(folder / "episodes.parquet").rename(columns=RENAMED))
        both = pd.read_parquet(folder / "differences.parquet").merge(differences(rows), on=TEST, suffixes=("_old", ""))
        counts = [int((both[name] < 0.05).sum()) for name in ("p_old", "p", "p_corrected")]
        print(f"{folder.name}: {len(both)} tests; p < 0.05: starts {counts[0]}, seeds {counts[1]}, stars {counts[2]}")


if __name__ == "__main__":
    main()
