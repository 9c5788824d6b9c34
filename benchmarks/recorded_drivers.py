"""Who drives more like the recorded drivers: a released checkpoint, or IDM and EIDM, calibrated.

Groups of `i80_replay` are driven behind their recorded leader and compared, instant by instant, with how vehicles 0
and 1 were recorded. IDM and EIDM are calibrated on groups without test vehicles (blocks of vehicle numbers,
docs/ngsim.md), by the best of random settings, of which a third are drawn near the best of the others. All are tested
on groups of test vehicles. Finished runs are kept in FOLDER.

    python benchmarks/recorded_drivers.py i-80.csv.gz FOLDER --settings 8
"""

import argparse
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

import cosim
from cosim.spec.loading import load_scenario, with_recording
from cosim.spec.scenario import Enforced, SumoDriver
from gri.core.policy import ConstantVelocity, IntelligentDriver
from gri.data.ngsim.rules import Rules, splits_of

QUANTITIES = ("gap", "time headway", "time to collision", "relative speed", "acceleration")
UNITS = ("m", "s", "1/s", "m/s", "m/s²")
RANGES = {"tau": (0.6, 1.8), "min_gap": (1.0, 3.0), "acceleration": (0.6, 2.5), "deceleration": (1.0, 4.0)}
RESAMPLES = 2000


def split_of(run: cosim.Run) -> pd.Series:
    """Of each group: "test" if all its vehicles are, "train" if none is, otherwise "mixed"."""
    names = run.groups[["vehicle_0", "vehicle_1", "vehicle_2"]]
    numbers = names.map(lambda name: int(str(name).rpartition("/")[2].partition(".")[0])).to_numpy()
    tested = (splits_of(numbers, Rules()) == "test").sum(axis=1)
    kinds = np.select([tested == numbers.shape[1], tested == 0], ["test", "train"], "mixed")
    return pd.Series(kinds, index=run.groups["episode"])


def errors(run: cosim.Run) -> pd.DataFrame:
    """Mean absolute differences between driven and recorded vehicles 0 and 1 at the same instant: a row per group."""
    steps = run.steps[run.steps["present"] & run.steps["during_drive"]].copy()
    steps["ahead"] = steps.groupby(["counterpart", "episode", "time"], sort=False)["v"].shift(-1)
    steps = steps[steps["role"].isin([0, 1])].set_index(["episode", "time", "role"])
    closing = steps["v"] - steps["ahead"]
    values = pd.DataFrame(
        {
            "gap": steps["gap"],
            "time headway": steps["gap"] / steps["v"].where(steps["v"] >= 1.0),
            "time to collision": (closing / steps["gap"].clip(lower=0.1)).clip(lower=0.0),  # its inverse, 0: none
            "relative speed": closing,
            "acceleration": steps["a"],
            "counterpart": steps["counterpart"],
        }
    )
    driven, recorded = (values[values["counterpart"] == of].drop(columns="counterpart") for of in (False, True))
    begin = run.groups.set_index("episode")["takeover_time"]
    difference = (driven - recorded).dropna(how="all").abs()
    level = difference.index.get_level_values
    return difference[level("time") > begin.loc[level("episode")].to_numpy() + 1e-6].groupby("episode").mean()


def run_of(name: str, folder: Path, recording: Path, driver: str, found: dict[str, float]) -> cosim.Run:
    """The run of one driver with these parameters."""
    path = folder / name
    if path.exists():
        return cosim.open_run(path)
    scenario = with_recording(load_scenario("i80_replay"), recording)
    policy = None
    if driver == "IDM":
        policy = IntelligentDriver(
            scenario.step,
            time_headway=found["tau"],
            minimum_gap=found["min_gap"],
            acceleration=found["acceleration"],
            deceleration=found["deceleration"],
        )
    elif driver == "GRI, no relation":
        scenario = msgspec.structs.replace(scenario, graph=Enforced(edges={}, others="none"))
    elif driver == "constant velocity":
        policy = ConstantVelocity(scenario.step)
    elif driver == "EIDM":
        kinds = tuple(
            msgspec.structs.replace(
                kind,
                car_following="EIDM",
                imperfection=None,
                imperfection_step=None,
                tau_cv=0.0,
                min_gap_sd=0.0,
                **found,
            )
            for kind in scenario.traffic.vehicles
        )
        traffic = msgspec.structs.replace(scenario.traffic, vehicles=kinds)
        scenario = msgspec.structs.replace(scenario, traffic=traffic, policy=SumoDriver())
    return cosim.run(scenario, policy, folder=path)


def calibrated(driver: str, folder: Path, recording: Path, settings: int) -> dict[str, float]:
    """The best of random settings: least mean error of the gap over groups without test vehicles."""
    rng, best = np.random.default_rng(0), (np.inf, dict[str, float]())
    for k in range(settings + settings // 2):
        near = k >= settings  # the last third is drawn around the best of the others
        between = {name: (0.6 * best[1][name], 1.4 * best[1][name]) for name in RANGES} if near else RANGES
        found = {name: round(float(rng.uniform(*between[name])), 3) for name in RANGES}
        run = run_of(f"{driver}-{k}", folder, recording, driver, found)
        error = errors(run)["gap"][split_of(run).eq("train")].mean()
        print(f"{driver} {k}: {error:.3f} m {found}", flush=True)
        best = min(best, (error, found), key=lambda of: of[0])
    return best[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--settings", type=int, default=8)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    runs = {
        "GRI": run_of("gri", given.folder, given.recording, "gri", {}),
        "GRI, no relation": run_of("gri-empty", given.folder, given.recording, "GRI, no relation", {}),
        "constant velocity": run_of("constant-velocity", given.folder, given.recording, "constant velocity", {}),
    }
    for driver in ("EIDM", "IDM"):
        found = calibrated(driver, given.folder, given.recording, given.settings)
        name = f"{driver}-{'-'.join(f'{value:g}' for value in found.values())}"
        runs[driver] = run_of(name, given.folder, given.recording, driver, found)
    split, rows = split_of(runs["GRI"]), []
    for part in ("test", "all"):
        chosen = split.index[split.eq("test")] if part == "test" else split.index
        tables = {name: errors(run).reindex(chosen) for name, run in runs.items()}
        draws = np.random.default_rng(0).integers(len(chosen), size=(RESAMPLES, len(chosen)))
        for quantity, unit in zip(QUANTITIES, UNITS, strict=True):
            for name, table in tables.items():
                values = table[quantity].to_numpy()
                low, high = np.nanquantile(np.nanmean(values[draws], axis=1), (0.025, 0.975))
                less = tables["GRI"][quantity].to_numpy() - values
                lower, upper = np.nanquantile(np.nanmean(less[draws], axis=1), (0.025, 0.975))
                rows.append(
                    (
                        part,
                        len(chosen),
                        quantity,
                        unit,
                        name,
                        np.nanmean(values),
                        low,
                        high,
                        np.nanmean(less),
                        lower,
                        upper,
                    )
                )
    columns = [
        "part",
        "groups",
        "quantity",
        "unit",
        "driver",
        "error",
        "low",
        "high",
        "gri_minus",
        "gri_low",
        "gri_high",
    ]
    table = pd.DataFrame(rows, columns=columns)
    table.to_csv(given.folder / "recorded_drivers.csv", index=False, float_format="%.4f")
    print(table.to_string(index=False, float_format="%.3f"))
    for name, run in runs.items():
        g = run.groups
        print(
            name,
            len(g),
            int(g["completed_without_contact"].sum()),
            int(g["contact"].sum()),
            g["ending"].value_counts().to_dict(),
        )


if __name__ == "__main__":
    main()
