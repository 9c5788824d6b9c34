"""Commands about traffic without driven groups: measure it, calibrate it, compare it with a recording."""

import os
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.commands.arguments import (
    DurationOption,
    MaxWorkOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    WorkersOption,
)
from gri.errors import InputError
from gri.storage.scratch import ScratchFolder
from gri.table import Table
from gri.terminal import FormatOption, ProgressDisplay, ShowProgress, finite, show_tables

if TYPE_CHECKING:
    from cosim.runs.traffic_survey import Survey
    from cosim.spec.scenario import Scenario
    from cosim.studies.calibration import Likeness
    from cosim.studies.screening import Effect

SITES = ["us101_car_following", "i80_car_following"]


def traffic(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCENARIO", help="Names or paths of scenarios; default: the two shipped sites."),
    ] = None,
    seed: SeedOption = None,
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds, counted up from the scenario's.")] = 1,
    duration: DurationOption = 600,
    settings: SetOption = None,
    max_work: MaxWorkOption = None,
    table_format: FormatOption = "table",
) -> None:
    """Simulate the traffic alone and compare it with targets.

    No vehicle is taken over. The table shows speeds, flows, lane use and
    collisions beside the recorded targets of the scenario.
    """
    from cosim.spec.loading import load_scenario, override

    named = [(load_scenario(name, max_work=max_work, settings=settings or ()), name) for name in scenarios or SITES]
    chosen = [override(_simulated(*one), {} if seed is None else {"seed": seed}) for one in named]
    tables = []
    for name, scenario in zip(scenarios or SITES, chosen, strict=True):
        variants = [override(scenario, {"seed": scenario.seed + k}) for k in range(seeds)]
        with ProgressDisplay() as progress:
            found = [survey_of(variant, duration, progress, f"seed {variant.seed}") for variant in variants]
        from cosim.studies.traffic_targets import statistics_table, traffic_statistics

        figures = [traffic_statistics(v, s) for v, s in zip(variants, found, strict=True)]
        tables.append(statistics_table(name, scenario, figures))
    show_tables(tables, table_format, then=f"cosim run {(scenarios or SITES)[0]}")


def calibrate(
    scenario: ScenarioArgument,
    free: Annotated[
        str,
        typer.Option(
            help="Parameters to search, separated by commas: tau (time headway of the drivers), limit (one factor for"
            " all speed limits of the bottleneck), limit.K (its limit in the K-th interval), and other numbers of"
            " drivers, lane changing and bottleneck (docs/calibration.md)."
        ),
    ] = "tau,limit",
    screen: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help="Instead of a search: paths on which to see which parameters matter."),
    ] = None,
    fit: Annotated[
        Path | None, typer.Option(help="Part of a recording to resemble besides the targets, as by cosim realism.")
    ] = None,
    offset: Annotated[
        float, typer.Option(callback=finite, help="With --fit: where its x = 0 is on the simulated road [m].")
    ] = 0.0,
    lanes: Annotated[str | None, typer.Option(help="With --fit: use only these lanes, such as 2,3,4.")] = None,
    views: Annotated[int, typer.Option(min=1, max=1000, help="With --fit: times at which each window is seen.")] = 8,
    target_speed: Annotated[
        float | None,
        typer.Option(callback=finite, help="Target of the mean speed [km/h] to use instead of the scenario's."),
    ] = None,
    evaluations: Annotated[int, typer.Option(min=1, help="Number of parameter settings to try.")] = 30,
    seeds: Annotated[
        int, typer.Option(min=1, help="Simulations per setting, with seeds counted up from the scenario's.")
    ] = 3,
    duration: DurationOption = 900,
    workers: WorkersOption = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the results; default: runs/calibrate/NAME.")] = None,
    settings: SetOption = None,
    max_work: MaxWorkOption = None,
    table_format: FormatOption = "table",
) -> None:
    """Fit drivers and speed limits to the recorded targets.

    With --fit also to a recording. The same command continues a search
    that was stopped. --screen says which parameters matter, before.
    """
    from cosim.spec.loading import load_scenario

    chosen = _with_target(
        _simulated(load_scenario(scenario, max_work=max_work, settings=settings or ()), scenario), target_speed
    )
    from cosim.studies.calibration import Calibration, calibrate
    from cosim.studies.calibration import screen as screened
    from cosim.studies.free_parameters import parameters
    from cosim.studies.traffic_targets import statistics_frame, statistics_table
    from gri.storage.claims import claimed_folder

    folder = out or Path("runs", "calibrate", Path(scenario).stem)
    numbers = tuple(chosen.seed + k for k in range(seeds))
    free_ones, likeness = parameters(free.split(","), chosen.traffic), _likeness(fit, offset, views, lanes)
    calibration = Calibration(chosen, free_ones, numbers, duration, folder, likeness)
    began, at_once = time.monotonic(), workers or os.cpu_count() or 1
    if screen is not None:
        with claimed_folder(folder), ProgressDisplay() as progress:
            found = screened(calibration, screen, chosen.seed, at_once, progress)
        text = f"{time.monotonic() - began:.0f} s, {screen * (len(free_ones) + 1)} settings with {seeds} seeds each."
        show_tables(_effect_tables(found), table_format, text, then=f"cosim calibrate {scenario} --free ...")
        return
    with claimed_folder(folder), ProgressDisplay() as progress:
        best = calibrate(calibration, evaluations, at_once, progress)
    statistics_frame(best.runs).to_csv(folder / "seeds.csv", index=False)
    values = ", ".join(f"{p.name} = {value:g}" for p, value in zip(calibration.free, best.values, strict=True))
    show_tables(
        [statistics_table(f"{scenario}, best", chosen, best.runs)],
        table_format,
        f"{values}; misfit {best.misfit:.3f} (below 1: within the tolerances of the targets).",
        f"{time.monotonic() - began:.0f} s. Traffic file: {folder}/traffic.yaml",
        then=f"cosim realism {scenario} --against RECORDING",
    )


def lane_numbers(text: str | None) -> list[int]:
    """Numbers separated by commas; none for no text."""
    try:
        return [int(lane) for lane in text.split(",")] if text else []
    except ValueError:
        raise InputError(f"--lanes: got {text!r}, wanted numbers such as 2,3,4") from None


def _likeness(fit: Path | None, offset: float, views: int, lanes: str | None) -> "Likeness | None":
    """The part of a recording to resemble."""
    if fit is None:
        return None
    from cosim.studies.calibration import Likeness
    from cosim.studies.observation_windows import windows_of
    from cosim.studies.traffic_samples import recorded_samples

    samples, chosen = recorded_samples(fit), lane_numbers(lanes)
    samples = samples[samples["lane"].isin(chosen)] if chosen else samples
    if not windows_of(samples)[0]:
        raise InputError("--fit: no part of the recording is 4 s long or longer; give a longer one")
    return Likeness(samples, offset, views)


def _effect_tables(found: "dict[str, list[Effect]]") -> list[Table]:
    """One table for each result: the parameters with their effects, the strongest first."""
    return [
        Table(
            result,
            ("parameter", "mean |effect|", "mean effect", "spread"),
            [(e.parameter, f"{e.mu_star:.3g}", f"{e.mu:+.3g}", f"{e.sigma:.3g}") for e in effects],
            [asdict(e) for e in effects],
            title=f"Effects on the {result} of a parameter's whole range (±25 %)",
            labels=1,
        )
        for result, effects in found.items()
    ]


def _simulated(scenario: "Scenario", name: str) -> "Scenario":
    from cosim.spec.scenario import SimulatedTraffic

    if not isinstance(scenario.background, SimulatedTraffic):
        raise InputError(f"{name}: got a scenario whose background is a recording, which has no demand; choose another")
    return scenario


def _with_target(scenario: "Scenario", target_speed: float | None) -> "Scenario":
    from msgspec.structs import replace

    targets = scenario.traffic.targets
    if target_speed is None or targets is None:
        return scenario
    if target_speed <= 0:
        raise InputError(f"--target-speed: got {target_speed:g} km/h, wanted a speed above 0")
    return replace(scenario, traffic=replace(scenario.traffic, targets=replace(targets, mean_speed=target_speed / 3.6)))


def survey_of(scenario: "Scenario", duration: float, progress: ShowProgress, stage: str) -> "Survey":
    """Survey the traffic in a process of its own; its progress is shown under the name of the stage."""
    from cosim.process.worker_process import run_in_worker

    with ScratchFolder() as scratch:
        return run_in_worker(
            "cosim.runs.traffic_survey:survey_job",
            scenario,
            duration,
            log=Path(scratch, "worker.log"),
            tell=lambda _, done, total: progress(stage, done, total),
        )
