"""The commands about traffic with nobody taken over: look at it, calibrate it, compare it with a recording."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.process.terminal import Stages, console, next_command, say
from gri.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from cosim.runs.traffic_survey import Survey
    from cosim.spec.scenario import Scenario

ScenarioArgument = Annotated[str, typer.Argument(help="Name of a shipped scenario, or path of a YAML file.")]
SITES = ["us101_car_following", "i80_car_following"]


def traffic(
    scenarios: Annotated[
        list[str] | None, typer.Argument(metavar="[SCENARIO]...", help="Names or paths; default: both shipped sites.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Replace the scenario's seed.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds, from the scenario's on.")] = 1,
    duration: Annotated[float, typer.Option(min=1, help="Seconds to look at after the warm-up.")] = 600,
) -> None:
    """Simulate traffic with nobody taken over, and tell how it flows and which recorded targets it reaches."""
    from cosim.spec.loading import load_scenario, override

    chosen = [
        override(_simulated(load_scenario(name), name), {} if seed is None else {"seed": seed})
        for name in scenarios or SITES
    ]
    for name, scenario in zip(scenarios or SITES, chosen, strict=True):
        variants = [override(scenario, {"seed": scenario.seed + k}) for k in range(seeds)]
        with Stages() as progress:
            found = [_survey(variant, duration, progress, f"seed {variant.seed}") for variant in variants]
        from cosim.studies.traffic_targets import figures_of, table_of

        console.print(table_of(name, scenario, [figures_of(v, s) for v, s in zip(variants, found, strict=True)]))
    next_command(f"cosim run {(scenarios or SITES)[0]}")


def calibrate(
    scenario: ScenarioArgument,
    free: Annotated[
        str, typer.Option(help="Numbers to search: tau, limit (all limits by one factor), limit.K (the K-th).")
    ] = "tau,limit",
    target_speed: Annotated[float | None, typer.Option(help="Replace the target of the mean speed [km/h].")] = None,
    evaluations: Annotated[int, typer.Option(min=1, help="Settings to try in all.")] = 30,
    seeds: Annotated[int, typer.Option(min=1, help="Simulations per setting, from the scenario's seed on.")] = 3,
    duration: Annotated[float, typer.Option(min=1, help="Seconds to look at after the warm-up.")] = 900,
    workers: Annotated[int | None, typer.Option(min=1, help="Simulations at a time; default: one per core.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder; default: runs/calibrate/NAME.")] = None,
) -> None:
    """Search drivers and bottleneck for traffic like the recorded one; the same command goes on where it stopped."""
    from cosim.spec.loading import load_scenario

    chosen = _with_target(_simulated(load_scenario(scenario), scenario), target_speed)
    from cosim.studies.calibration import Search, calibrate, parameters
    from cosim.studies.traffic_targets import frame_of, table_of

    folder = out or Path("runs", "calibrate", Path(scenario).stem)
    numbers = tuple(chosen.seed + k for k in range(seeds))
    search = Search(chosen, parameters(free.split(","), chosen.traffic), numbers, duration, folder)
    began = time.monotonic()
    with Stages() as progress:
        best = calibrate(search, evaluations, workers or os.cpu_count() or 1, progress.tell)
    frame_of(best.runs).to_csv(folder / "seeds.csv", index=False)
    console.print(table_of(f"{scenario}, best", chosen, best.runs))
    values = ", ".join(f"{p.name} = {value:g}" for p, value in zip(search.free, best.values, strict=True))
    say(f"{values}; misfit {best.misfit:.3f} (below 1: within the tolerances). {time.monotonic() - began:.0f} s.")
    say(f"Traffic file: {folder}/traffic.yaml")
    next_command(f"cosim realism {scenario} --against RECORDING")


def _simulated(scenario: "Scenario", name: str) -> "Scenario":
    from cosim.spec.scenario import Simulated

    if not isinstance(scenario.background, Simulated):
        raise InputError(f"{name}: its background is a recording, which has no demand; choose a simulated one")
    return scenario


def _with_target(scenario: "Scenario", target_speed: float | None) -> "Scenario":
    from msgspec.structs import replace

    targets = scenario.traffic.targets
    if target_speed is None or targets is None:
        return scenario
    if target_speed <= 0:
        raise InputError(f"--target-speed: got {target_speed:g} km/h, wanted a speed above 0")
    return replace(scenario, traffic=replace(scenario.traffic, targets=replace(targets, mean_speed=target_speed / 3.6)))


def realism(
    subject: Annotated[str, typer.Argument(metavar="SCENARIO|RUN", help="A scenario, or the folder of a run.")],
    against: Annotated[Path, typer.Option(help="NGSIM file, scene file, or Parquet table of samples.")],
    stretch: Annotated[
        tuple[float, float] | None, typer.Option(help="Only this stretch of the simulated road [m], FROM TO.")
    ] = None,
    lanes: Annotated[str | None, typer.Option(help="Only these lanes, counted from the left, such as 2,3,4.")] = None,
    seed: Annotated[int | None, typer.Option(help="Replace the scenario's seed.")] = None,
    duration: Annotated[float, typer.Option(min=1, help="Seconds to look at after the warm-up.")] = 600,
    out: Annotated[Path | None, typer.Option(help="Folder to write; default: a new one in runs/.")] = None,
) -> None:
    """Compare speeds, accelerations, headways and time gaps with a recording: distances, intervals, a picture."""
    from cosim.runs.run_folder import next_folder, run_folder

    is_run = Path(subject, "steps.parquet").is_file()
    began = time.monotonic()
    if is_run and (stretch or seed is not None):
        raise InputError("--stretch and --seed are for scenarios; this is a run folder")
    read = _of_run if is_run else lambda name: _of_scenario(name, seed, duration)
    chosen = _lanes(lanes)
    folder = out or next_folder(Path("runs"), f"{Path(subject).stem}-realism")
    with run_folder(folder) as partial:
        from cosim.studies.traffic_samples import recorded_samples

        recorded = recorded_samples(against)
        simulated = read(subject)
        if stretch is not None:
            simulated = simulated[simulated["x"].between(*stretch)]
        if chosen:
            recorded = recorded[recorded["lane"].isin(chosen)]
            simulated = simulated if is_run else simulated[simulated["lane"].isin(chosen)]
        from cosim.studies.realism_report import write

        table = write(partial, simulated, recorded)
    console.print(table)
    say(f"{time.monotonic() - began:.0f} s. Distances and picture: {folder}")
    next_command(f"cosim calibrate {subject}" if not is_run else f"cosim report {subject}")


def _lanes(text: str | None) -> list[int]:
    try:
        return [int(lane) for lane in text.split(",")] if text else []
    except ValueError:
        raise InputError(f"--lanes: got {text!r}, wanted numbers such as 2,3,4") from None


def _of_run(folder: str) -> "pd.DataFrame":
    from cosim.studies.traffic_samples import run_samples

    return run_samples(Path(folder))


def _of_scenario(name: str, seed: int | None, duration: float) -> "pd.DataFrame":
    from cosim.spec.loading import load_scenario, override

    scenario = override(load_scenario(name), {} if seed is None else {"seed": seed})
    with Stages() as progress:
        found = _survey(scenario, duration, progress, "traffic")
    from cosim.studies.traffic_samples import with_headways

    return with_headways(found.samples.assign(source="simulated"))


def _survey(scenario: "Scenario", duration: float, progress: Stages, stage: str) -> "Survey":
    """A survey in a process of its own, whose progress is told under that name."""
    from cosim.process.worker_process import run_in_worker

    tell: Callable[..., None] = lambda _, done, of: progress.tell(stage, done, of)  # noqa: E731
    with TemporaryDirectory() as scratch:
        return run_in_worker(
            "cosim.runs.run_job:survey_job", scenario, duration, log=Path(scratch, "worker.log"), tell=tell
        )
