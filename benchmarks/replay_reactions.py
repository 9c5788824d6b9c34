"""Groups driven among recorded vehicles, with and without reactions of those behind them (docs/replay.md).

The leader (vehicle 2) moves as recorded, or brakes for two seconds. The same groups are driven by every
policy, once among vehicles that react to nobody and once with `background.react`. Finished runs are kept in FOLDER.

    python benchmarks/replay_reactions.py us-101.csv.gz FOLDER
"""

import argparse
from pathlib import Path
from typing import Any

import pandas as pd

import cosim

SETTINGS = (("2", "4", ("idm", "constant_velocity")), ("5", "5", ("us101_car_following", "idm", "constant_velocity")))
LEADERS = ("none", "3", "5", "8")  # braking [m/s²]
MEMBERS = {"0", "1", "2"}


def facts(run: cosim.Run) -> dict[str, Any]:
    """What happened to the groups of a run, and who was released."""
    groups, released = run.groups, run.releases
    pairs = [{s.split("→")[0] for s in with_whom.split(",") if s} for with_whom in groups["contact_with"]]
    return {
        "groups": len(groups),
        "completed_without_contact": int(groups["completed_without_contact"].sum()),
        "contact": int(groups["contact"].sum()),
        "hit_by_a_recorded_vehicle": sum(bool(rear - MEMBERS) for rear in pairs),
        "cut_in": int((groups["ending"] == "cut_in").sum()),
        "lane_left": int((groups["ending"] == "lane_left").sum()),
        "released": len(released),
        "groups_with_releases": released["episode"].nunique(),
        "median_after_s": released["after"].median(),
    }


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("recording", type=Path)
parser.add_argument("folder", type=Path)
given = parser.parse_args()
given.folder.mkdir(parents=True, exist_ok=True)
rows = []
for history, horizon, policies in SETTINGS:
    for leader in LEADERS:
        for policy in policies:
            for react in ("false", "true"):
                folder = given.folder / f"{history}_{horizon}_{leader}_{policy}_{react}"
                settings = [f"history={history}", f"horizon={horizon}", "episodes=500", "background.overlap=true"]
                settings.append(f"background.react={react}")
                if leader != "none":
                    settings.append(f"perturbations=[{{kind: leader_braking, intensity: {leader}}}]")
                run = (
                    cosim.open_run(folder)
                    if folder.exists()
                    else cosim.run("us101_replay", policy, recording=given.recording, settings=settings, folder=folder)
                )
                rows.append(
                    {"history": history, "horizon": horizon, "leader": leader, "policy": policy, "react": react}
                    | facts(run)
                )
                print(rows[-1], flush=True)
pd.DataFrame(rows).to_csv(given.folder / "replay_reactions.csv", index=False)
