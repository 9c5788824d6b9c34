"""The command `cosim realism`."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from cosim.commands.arguments import DurationOption, SeedOption, SetOption
from cosim.commands.traffic import lane_numbers, survey_of
from gri.errors import InputError
from gri.terminal import FormatOption, ProgressDisplay, finite, show_tables

if TYPE_CHECKING:
    import pandas as pd


def realism(
    subject: Annotated[str, typer.Argument(metavar="SCENARIO|RUN", help="A scenario, or a run folder.")],
    against: Annotated[
        Path | None,
        typer.Option(help="A recording of any layout (docs/recordings.md), a scene file, or a table of samples."),
    ] = None,
    counterparts: Annotated[
        bool,
        typer.Option(
            "--counterparts", help="Compare the driven groups of a run with the same groups without the policy."
        ),
    ] = False,
    test: Annotated[
        Path | None, typer.Option(help="A recording to score the traffic with, instead of --against.")
    ] = None,
    fit: Annotated[
        Path | None,
        typer.Option(help="With --test: another part of the recording, for the ceiling; default: halves of it."),
    ] = None,
    offset: Annotated[
        float,
        typer.Option(callback=finite, help="With --test: where x = 0 of the recording is on the simulated road [m]."),
    ] = 0.0,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="With --test: simulations, seeds counted up.")] = 3,
    views: Annotated[
        int, typer.Option(min=1, max=1000, help="With --test: times at which each recorded window is looked at.")
    ] = 32,
    stretch: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="FROM TO", callback=finite, help="Use only this stretch of the simulated road [m]."),
    ] = None,
    lanes: Annotated[
        str | None, typer.Option(help="Use only these lanes, counted from the left, such as 2,3,4.")
    ] = None,
    seed: SeedOption = None,
    duration: DurationOption = 600,
    out: Annotated[Path | None, typer.Option(help="Folder to write; default: a new one in runs/.")] = None,
    settings: SetOption = None,
    table_format: FormatOption = "table",
) -> None:
    """Compare simulated traffic with a recording.

    With --against: the distances between the distributions of speeds,
    accelerations, headways and time gaps, with 95 % intervals, and a picture.
    With --test: one score, from the likelihood of the recording under the
    traffic, which is seen through the recording's own windows.
    """
    from cosim.runs.run_folder import next_folder, run_folder

    if (against is not None) + (test is not None) + counterparts != 1:
        raise InputError("--against, --test and --counterparts: expected one of them; see docs/realism.md")
    if test is not None:
        sought = _Score(test, fit, offset, seeds, views, seed, duration, settings or [], lane_numbers(lanes))
        return _score(subject, sought, out or next_folder(Path("runs"), f"{Path(subject).stem}-score"), table_format)
    if fit is not None:
        raise InputError("--fit: is for --test; leave it out, or give --test")
    is_run = Path(subject, "steps.parquet").is_file()
    if counterparts and not is_run:
        raise InputError(f"--counterparts: is for run folders, and {subject} is none; give --against, a recording")
    began = time.monotonic()
    if is_run and (stretch or settings or seed is not None):
        raise InputError(
            f"{subject}: --stretch, --seed and --set are for scenarios, and this is a run folder; leave them out"
        )
    read = _of_run if is_run else lambda name: _of_scenario(name, seed, duration, settings or [])
    chosen = lane_numbers(lanes)
    folder = out or next_folder(Path("runs"), f"{Path(subject).stem}-realism")
    with run_folder(folder) as partial:
        from cosim.studies.traffic_samples import recorded_samples

        simulated = read(subject)
        recorded = _without_policy(simulated, subject) if against is None else recorded_samples(against)
        if against is None:
            simulated = simulated[simulated["driver"] != recorded["driver"].iloc[0]]
        if stretch is not None:
            simulated = simulated[simulated["x"].between(*stretch)]
        if chosen and against is not None:
            recorded = recorded[recorded["lane"].isin(chosen)]
            simulated = simulated if is_run else simulated[simulated["lane"].isin(chosen)]
        from cosim.studies.realism_report import write_realism_report

        table = write_realism_report(partial, simulated, recorded)
    show_tables(
        [table],
        table_format,
        f"{time.monotonic() - began:.0f} s. Distances and picture: {folder}",
        then=f"cosim report {subject}" if is_run else f"cosim calibrate {subject}",
    )


def _of_run(folder: str) -> "pd.DataFrame":
    from cosim.studies.traffic_samples import run_samples

    return run_samples(Path(folder))


def _without_policy(samples: "pd.DataFrame", folder: str) -> "pd.DataFrame":
    """The samples of a run that no policy drove."""
    left = samples[samples["driver"].isin(["recorded", "sumo"])]
    if left.empty or left["driver"].nunique() == samples["driver"].nunique():
        raise InputError(f"{folder}: has no driven groups with counterparts to compare; drive by another policy")
    return left


def _of_scenario(name: str, seed: int | None, duration: float, settings: list[str]) -> "pd.DataFrame":
    from cosim.spec.loading import load_scenario, override

    scenario = override(load_scenario(name, settings=settings), {} if seed is None else {"seed": seed})
    with ProgressDisplay() as progress:
        found = survey_of(scenario, duration, progress, "traffic")
    from cosim.studies.traffic_samples import with_headways

    return with_headways(found.samples.assign(source="simulated"))


class _Score(NamedTuple):
    """What `--test` and its options ask for."""

    test: Path
    fit: Path | None
    offset: float
    seeds: int
    views: int
    seed: int | None
    duration: float
    settings: list[str]
    lanes: list[int]


def _score(subject: str, sought: _Score, folder: Path, table_format: FormatOption) -> None:
    """Simulate the seeds, score them, and show the tables."""
    from cosim.runs.run_folder import run_folder
    from cosim.spec.loading import load_scenario, override

    scenario = load_scenario(subject, settings=sought.settings)
    first = scenario.seed if sought.seed is None else sought.seed
    variants = [override(scenario, {"seed": first + k}) for k in range(sought.seeds)]
    began = time.monotonic()
    with run_folder(folder) as partial:
        from cosim.studies.score_report import write_score
        from cosim.studies.traffic_samples import recorded_samples

        recorded, other = (None if p is None else recorded_samples(p) for p in (sought.test, sought.fit))
        assert recorded is not None
        if sought.lanes:
            recorded = recorded[recorded["lane"].isin(sought.lanes)]
            other = None if other is None else other[other["lane"].isin(sought.lanes)]
        with ProgressDisplay() as progress:
            found = [survey_of(variant, sought.duration, progress, f"seed {variant.seed}") for variant in variants]
        samples = [one.samples for one in found]
        tables = write_score(partial, samples, recorded, other, sought.views, sought.offset)
    text = f"{time.monotonic() - began:.0f} s. Scores and space-time diagram: {folder}"
    show_tables(tables, table_format, text, then=f"cosim calibrate {subject}")
