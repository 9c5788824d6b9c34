"""The Markdown pages of the paper's tables: notes, and tables with ours beside the paper's figures."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from gri.data.scene_file.schema import header_of
from gri.evaluation.out_of_distribution import Front
from gri.evaluation.recorded_scores import RATIOS
from gri.paper.job_cache import Job, scenarios_of
from gri.paper.rows import Row, Scenario
from gri.paper.score_frames import ORACLE_SEED, STAGES, areas, rates, weight_frame
from gri.paper.table_builder import (
    CPU_SECONDS,
    NOTHING,
    SEEDS,
    Column,
    Line,
    column,
    lines_of,
    score_columns,
    success_column,
    table,
)

SYNTHETIC_NOTES = """\
Ours: mean over seeds ± standard deviation over test scenes (mean over seeds) [lowest seed, highest seed]. Paper: mean
± standard deviation. "4 edges": edges into driven vehicles; F1 is over those. The types of some models have no defined
meaning: for the accuracy, their labels are renamed, except "none". Absolute errors depend on constants of the scenes
and on the noise of the expert, which the paper does not print: compare the ratios of rows.
"""
OOD_NOTES = """\
Only the edge 1 -> 0, "follow", remains. Vehicle 0 starts at the headway in the heading of the column. Success: vehicle
0 is at least 2 m behind vehicle 1 after T steps. GRI's training also maximises the learned reward from shifted starts.
These cover the headways of the test, without demonstrations. In these roll-outs, the row "tested range held out" does
not react to vehicles nearer than the shortest headway of the training scenes. The oracle is the open-loop optimum of
the true reward over the same T steps. Policies can exceed it, because it does not maximise success. Success does not
exclude collisions: read both tables.
"""
IN_ONE_LANE = (
    " In one lane, a vehicle that starts beside or ahead of vehicle 1 succeeds only by passing through it: a collision."
)
FLIP_NOTES = """\
Flip test, lowest seed: the type of one edge is changed on the same start. Share of scenes [%] in which the final
headway x_i − x_j changes as it does in the optimum of the true reward ("order": its sign; "lateral": the lateral
distance). Scenes in which the optimum changes by less than 0.1 m do not count.
"""
WEIGHT_NOTES = "Weight of each reward term over the weight of the jerk, mean over seeds [lowest seed, highest seed]:\n"
FRONTS = {
    Front.CONSTANT_SPEED: "Vehicle 1 keeps its speed",
    Front.POLICY: "The same policy drives vehicle 1, which has no edges",
}
CAR_FOLLOWING_NOTES = """\
Ours: mean over test scenes and seeds ± standard deviation over scenes (mean over seeds) [lowest seed, highest seed].
Half of the 95 % interval of a mean over {count} scenes is {share:.2f} standard deviations. Paper: mean ± standard
deviation, on its own selection of scenes. Accuracy: agreement with the hypothesis over all six edges. The empty graph
has 66.7 %. The prior allows GRI no edges but the two of the hypothesis (docs/ngsim.md). ADE, FDE: mean and final
displacement of the roll-out of mean actions; min: the best of 20 roll-outs with sampled actions. Contacts: share of
scenes in which a net gap reaches 0 (unknown lengths count as 4.6 m).
"""
CAR_FOLLOWING_OOD_NOTES = """\
Success rate, and in brackets collision rate [%] (closer than 2 m at some step), against δ, the share by which the
headway is shrunk: vehicle 0 starts at (1 − δ)·Δx behind vehicle 1.
Vehicle 1 drives as recorded, and only the edge 1 → 0 remains. Mean over seeds ± half of the 95 % interval over the
scenes of one seed. GRI's training also maximises the learned reward from starts shifted by −5 to 30 m, without
demonstrations.
"""
LANE_CHANGE_NOTES = """\
Training: on windows whose motion along the road is recorded and whose lateral motion is drawn. Noise with standard
deviations of {0.blur[0]} m/s and {0.blur[1]} m/s² is added to lateral speeds and accelerations at the start. No vehicle
of a recorded lane change is in these windows. "Fine-tuned": the same model after {0.tuning.updates} more updates on the
recorded lane changes of all folds but one of {0.folds}, with {0.drawn_per_recorded} times as many drawn ones, tested on
the remaining fold.

Mean over windows and seeds ± half of the 95 % interval [lowest seed, highest seed]. For the interval, windows that
share vehicles count as one. Paper: mean ± standard deviation, on its own selection of scenes. Accuracy: agreement with
the hypothesis of the window, H1 or H2, over all six edges (docs/ngsim.md). The empty graph has 66.7 % under H1 and 50 %
under H2. The prior allows GRI no edges but those of the hypotheses, with odds of 49 to 1 for following and of 2 to 1
for yielding. RMSE_v is the error of the speed along the road.
"""
LANE_CHANGE_OOD_NOTES = """\
Success rate, and in brackets collision rate [%], against δ, the share by which the headway is shrunk. Only vehicle 0
and the vehicle it yields to remain, 1 in H1 and 2 in H2, with the edge over which vehicle 0 yields. The other vehicle
drives as recorded. ± is half of the 95 % interval over the windows of one seed.
"""


def score_page(target: str, jobs: Sequence[Job], cache: Path, scores: pd.DataFrame) -> str:
    """Table I or III: scores, flip tests and reward weights of synthetic scenarios."""
    scenes = ", ".join(str(count) for count in sorted(scores[scores["metric"] == "rmse_x"]["scenes"].unique()))
    parts = [f"# {target}: {seed_count(jobs)} seeds, {scenes} test scenes\n", SYNTHETIC_NOTES]
    for scenario in scenarios_of(jobs):
        ours = scores[scores["scenario"] == scenario.name]
        flips = ours[ours["metric"].str.startswith("flip ")]
        weights = weight_frame([job for job in jobs if job.scenario.name == scenario.name], cache)
        parts += [f"## {scenario.title}\n", score_table(scenario, ours)]
        parts += [FLIP_NOTES, flip_table(scenario, flips)] if len(flips) else []
        parts += [WEIGHT_NOTES, weight_table(scenario, weights)] if len(weights) else []
    return "\n".join(parts)


def seed_count(jobs: Sequence[Job]) -> str:
    """How many seeds the rows have: "5", or "1 to 5"."""
    counts = Counter((job.scenario.name, job.row.name) for job in jobs).values()
    return str(max(counts)) if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"


def score_table(scenario: Scenario, scores: pd.DataFrame) -> str:
    """The scores of a synthetic scenario."""
    columns = [
        *score_columns(scenario, digits=4, published_digits=3, percent_digits=2),
        column("4 edges [%]", "driven_accuracy", 2, 100.0, over_seeds="range", width="std"),
        Column("F1 per type", _f1),
    ]
    empty = scores[scores["metric"] == "empty_graph_accuracy"].assign(metric="accuracy")
    references = [Line("empty graph", empty)] if len(empty) else []
    return table([*columns, SEEDS, CPU_SECONDS], lines_of(scenario.rows, scores) + references)


def _f1(line: Line) -> str:
    f1 = line.scores[line.scores["metric"].str.startswith("f1_")]
    means = f1.groupby("metric", sort=False)["mean"].mean()
    return ", ".join(f"{str(kind).removeprefix('f1_')} {mean:.3f}" for kind, mean in means.items()) or NOTHING


def flip_table(scenario: Scenario, flips: pd.DataFrame) -> str:
    """Share of scenes [%] in which a changed edge type has the effect that it has in the optimum."""
    kinds = flips["metric"].unique()
    columns = [column(kind.removeprefix("flip "), kind, 1, 100.0, over_seeds="lowest") for kind in kinds]
    return table(columns, lines_of(scenario.rows, flips))


def weight_table(scenario: Scenario, weights: pd.DataFrame) -> str:
    """True and learned weights of every reward term."""
    columns = [column(term, term, 2, over_seeds="range") for term in weights["metric"].unique()]
    true = weights.drop_duplicates("metric").assign(mean=lambda first: first["true"])
    return table(columns, [Line("true", true), *lines_of(scenario.rows, weights)])


def curve_page(jobs: Sequence[Job], curves: pd.DataFrame) -> str:
    """The out-of-distribution test of synthetic scenarios."""
    parts = [f"# Out of distribution: success rate [%], mean over {seed_count(jobs)} seeds\n", OOD_NOTES]
    for scenario in scenarios_of(jobs):
        for front, title in FRONTS.items():
            parts += [f"## {scenario.title}. {title}\n", rate_table(scenario, curves, front)]
            one_lane = "" if "y" in scenario.features else IN_ONE_LANE
            parts += [f"Collision rate [%]: closer than 2 m at some step.{one_lane}\n"]
            parts += [rate_table(scenario, curves, front, "collision")]
    return "\n".join(parts)


def rate_table(scenario: Scenario, curves: pd.DataFrame, front: Front, rate: str = "success") -> str:
    """A rate [%] by headway, mean over seeds; for success also the area under the curve."""
    chosen = curves[(curves["scenario"] == scenario.name) & (curves["front"] == front)]
    headways = sorted(chosen["headway"].unique(), reverse=True)
    columns = [column(f"{x:+.0f} m", x, 1, 100.0, key="headway", value=rate) for x in headways]
    if rate == "success":
        area = areas(chosen).groupby("row")
        means, lowest = area["area"].mean(), area["share_of_oracle"].min()
        columns.append(Column("area", lambda line: f"{means[line.label]:.3f}"))
        columns.append(Column("area ÷ oracle's, lowest seed", lambda line: f"{lowest[line.label]:.3f}"))
        columns.append(SEEDS)
    oracle = Line("oracle", chosen[chosen["seed"] == ORACLE_SEED])
    return table(columns, [oracle, *lines_of(scenario.rows, chosen)])


def car_following_page(jobs: Sequence[Job], cache: Path, scores: pd.DataFrame, curves: pd.DataFrame) -> str:
    """Table II of recorded car following."""
    scenario = jobs[0].scenario
    whole = [job for job in jobs if job.site is None]
    sites = Counter(whole[0].result(cache)["site"])
    counts = ", ".join(f"{count} of {site}" for site, count in sorted(sites.items()))
    ours, points = (frame[frame["trained_on"] == "both"] for frame in (scores, curves))
    parts = [
        "# Table II: recorded car following (NGSIM)\n",
        f"Test scenes: {counts}, cut from {recordings_of(whole[0])}.\n",
        CAR_FOLLOWING_NOTES.format(count=sites.total(), share=1.96 / sites.total() ** 0.5),
        table([*score_columns(scenario, 3, 3, 2), SEEDS, CPU_SECONDS], lines_of(scenario.rows, ours)),
        "## Beyond the paper\n",
        driving_table(scenario, ours),
        "## Out of distribution\n",
        CAR_FOLLOWING_OOD_NOTES,
        table([success_column(ratio, 1) for ratio in RATIOS], lines_of(scenario.rows, points)),
        "## Sites\n",
        "RMSE_x [m] on the test scenes of each site, by the site of the training scenes.\n",
        site_table(scenario, scores, sorted(sites)),
    ]
    drivers = [job.result(cache)["parameters"] for job in whole if job.row.calibrated]
    return "\n".join([*parts, *[f"Calibrated IDM: {', '.join(f'{k} {v}' for k, v in d.items())}.\n" for d in drivers]])


def recordings_of(job: Job) -> str:
    """Names of the recordings that the scene file of a job was cut from."""
    assert job.scene_file is not None
    return ", ".join(file["name"] for file in header_of(job.scene_file.path).provenance["ngsim"]["files"])


def driving_table(scenario: Scenario, scores: pd.DataFrame) -> str:
    """Displacements, contacts, headways, and distances between driven and recorded distributions."""
    columns = [
        column("ADE [m]", "ade", 2),
        column("FDE [m]", "fde", 2),
        column("minADE [m]", "min_ade", 2),
        column("minFDE [m]", "min_fde", 2),
        column("contacts [%]", "collision", 1, 100.0),
        column("time headway [s]", "time_headway", 2),
        column("W1 time headway [s]", "wasserstein_time_headway", 3),
        column("W1 speed [m/s]", "wasserstein_speed", 3),
        column("W1 acceleration [m/s²]", "wasserstein_acceleration", 3),
    ]
    recorded = scores[scores["metric"].str.endswith("_recorded")].drop_duplicates("metric")
    recorded = recorded.assign(metric=recorded["metric"].str.removesuffix("_recorded"))
    return table(columns, [*lines_of(scenario.rows, scores), Line("recorded", recorded)])


def site_table(scenario: Scenario, scores: pd.DataFrame, sites: Sequence[str]) -> str:
    """Transfer between sites: the error at each site by the site that was trained on."""
    trained_on = Column("trained on", lambda line: line.scores["trained_on"].iloc[0])
    errors = [column(f"tested on {site}", f"rmse_x at {site}", 2, over_seeds="range", width="std") for site in sites]
    whole = scores["trained_on"] == "both"
    lines = lines_of(scenario.rows, scores[whole])
    for line in lines_of(scenario.rows, scores[~whole]):
        lines += [Line(line.label, part, line.row) for _, part in line.scores.groupby("trained_on")]
    return table([trained_on, *errors], lines)


def lane_change_page(jobs: Sequence[Job], cache: Path, scores: pd.DataFrame, curves: pd.DataFrame) -> str:
    """Table II of recorded lane changes, by cross-validation."""
    scenario, first = jobs[0].scenario, jobs[0].result(cache)
    windows, clusters = len(first["site"]), len(set(first["cluster"]))
    displacements = [column("ADE [m]", "ade", 2), column("FDE [m]", "fde", 2)]
    columns = [*score_columns(scenario, 2, 2, 1, width="half_width"), *displacements, SEEDS, CPU_SECONDS]
    by_row = [line for row in scenario.rows for stage in STAGES for line in _at_stage([row], scores, stage)]
    by_stage = [line for stage in STAGES for line in _at_stage(scenario.rows, rates(curves), stage)]
    parts = [
        "# Table II: recorded lane changing (NGSIM)\n",
        f"{windows} recorded windows in {clusters} groups that share no vehicle, cut from {recordings_of(jobs[0])}.\n",
        LANE_CHANGE_NOTES.format(scenario.cross_validation),
        table(columns, by_row),
        "## Out of distribution\n",
        LANE_CHANGE_OOD_NOTES,
        table([success_column(ratio, 0) for ratio in RATIOS], by_stage),
    ]
    return "\n".join(parts)


def _at_stage(rows: Sequence[Row], frame: pd.DataFrame, stage: str) -> list[Line]:
    label = "{}" if stage == STAGES[0] else f"{{}}, {stage}"
    return lines_of(rows, frame[frame["stage"] == stage], label)
