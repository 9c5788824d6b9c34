"""What the paper's tables and figures consist of: scenarios and their rows, as data.

A row is a training configuration that comes with the project: `scenarios/train/PREFIX + suffix.yaml`. A row without
such a file is left out of the tables. To add a row to a scenario, add the file.
"""

from dataclasses import dataclass
from functools import cache

import msgspec

from gri import resources
from gri.config import checked, parsed
from gri.core.graph import EdgeType
from gri.data.ranges.recorded import NGSIM_CAR_FOLLOWING, NGSIM_LANE_CHANGING, RecordedRange
from gri.evaluation.diagnostics import Flip
from gri.evaluation.out_of_distribution import Protocol
from gri.training.fine_tuning import FineTuning
from gri.training.train import TrainConfig, read_train_config

FOLLOWING_PROTOCOL = Protocol()
LANE_PROTOCOL = Protocol(headways=tuple(float(x) for x in range(8, -9, -1)), kept=(0, 2))
FINE_TUNING = FineTuning(updates=60)


@dataclass(frozen=True)
class Row:
    """One model of a table."""

    name: str
    suffix: str
    published: str | None
    """The paper's row that is printed beside it."""
    tables: tuple[str, ...] = ("table1",)
    defined_types: bool = True
    """Its edge types have the meaning of the definitions. Otherwise tests force the types that the model infers."""
    calibrated: bool = False
    """Has no training configuration: the parameters of a car-following model are fitted, once for all seeds."""
    transfers: bool = False
    """Is also trained on each recorded site alone and tested on all."""
    uses_reward: bool = False
    """Of recorded scenes: its training depends on the reward of the range."""


@dataclass(frozen=True)
class CrossValidation:
    """How models of recorded lane changes are fine-tuned and tested (`recorded_lane_changes`)."""

    folds: int = 5
    tuning: FineTuning = FINE_TUNING
    drawn_per_recorded: int = 4
    """Drawn windows for each recorded one in fine-tuning, which otherwise fits the few recorded windows too closely."""
    blur: tuple[float, float] = (0.2, 0.3)
    """Standard deviations of the noise on first lateral speeds [m/s] and accelerations [m/s²] of drawn windows."""


@dataclass(frozen=True)
class Scenario:
    """A kind of scene, its rows and its tests."""

    name: str
    title: str
    prefix: str
    features: tuple[str, ...]
    rows: tuple[Row, ...]
    protocol: Protocol = FOLLOWING_PROTOCOL
    """The out-of-distribution test of synthetic scenes."""
    flips: tuple[Flip, ...] = ()
    recorded: RecordedRange | None = None
    """What recorded scenes have in common; None for synthetic scenes."""
    cross_validation: CrossValidation | None = None
    """How recorded lane changes are trained and tested; None for the other scenarios."""


NONE, FOLLOW, YIELD, CUT_IN = EdgeType
FOLLOWING_FLIPS = (Flip(1, 0, NONE, FOLLOW, "headway"),)
LANE_FLIPS = (
    Flip(2, 0, NONE, FOLLOW, "headway"),
    Flip(2, 0, NONE, FOLLOW, "lateral"),
    Flip(2, 0, FOLLOW, YIELD, "lateral"),
    Flip(0, 1, YIELD, CUT_IN, "headway"),
    Flip(0, 1, YIELD, CUT_IN, "order"),
)
ROWS = (
    Row("GRI", "", "GRI", ("table1", "table3", "ood", "equal_terms")),
    Row("GRI (paper, contrast)", "_airl", "GRI", ("table1", "table3", "ood", "equal_terms")),
    Row("GRI (paper, literal)", "_airl_literal", "GRI", ("table1", "ood", "equal_terms")),
    Row("NRI", "_nri", "NRI", ("table1", "ood", "equal_terms"), defined_types=False),
    Row("NRI, type 0 speaks", "_nri_type0", "NRI", ("table1", "ood"), defined_types=False),
    Row("Supervised", "_supervised", "Supervised", ("table1", "ood", "equal_terms")),
    Row("GRI, recurrent decoder", "_recurrent", "GRI", ("table1",)),
    Row("GRI, tested range held out", "_strict", "GRI", ("ood",)),
    Row("GRI-VAIRL", "_gri_vairl", "GRI-VAIRL", ("table3", "ood", "equal_terms"), defined_types=False),
    Row("GRI-AIRL", "_gri_airl", "GRI-AIRL", ("table3", "ood", "equal_terms"), defined_types=False),
)
EQUAL = ("equal_terms",)
EQUAL_TERMS_ROWS = (
    Row("GRI (paper, contrast), literal weights", "_airl_with_literal", "GRI", EQUAL),
    Row("GRI (paper, contrast), networks (VAIRL)", "_airl_with_networks", "GRI-VAIRL", EQUAL, defined_types=False),
    Row(
        "GRI (paper, contrast), networks, pairs alike (AIRL)",
        "_airl_with_networks_all_alike",
        "GRI-AIRL",
        EQUAL,
        defined_types=False,
    ),
    Row("NRI, bottleneck rate 1", "_nri_rate1", "NRI", EQUAL, defined_types=False),
    Row("NRI + shifted demonstrations", "_nri_shifted", "NRI", EQUAL, defined_types=False),
    Row("Supervised + shifted demonstrations", "_supervised_shifted", "Supervised", EQUAL),
    Row("GRI, constants x2, learned", "_constants_x2", "GRI", EQUAL),
    Row("GRI, constants x2, untrained reward", "_constants_x2_untrained", "GRI", EQUAL),
)
"""Each differs from another row in what its name says (docs/equal-terms.md)."""
OTHER_EXPERT_ROWS = (
    Row("GRI", "", None, EQUAL),
    Row("GRI, constants x2, learned", "_constants_x2", None, EQUAL),
    Row("GRI (paper, contrast)", "_airl", None, EQUAL),
    Row("NRI", "_nri", None, EQUAL, defined_types=False),
    Row("Supervised", "_supervised", None, EQUAL),
)
MIXED_ROWS = (Row("GRI", "", None), Row("GRI (paper, contrast)", "_airl", None), Row("Supervised", "_supervised", None))
RECORDED_ROWS = (
    Row("GRI", "", "GRI", ("table2",), transfers=True, uses_reward=True),
    Row("GRI (paper)", "_airl", "GRI", ("table2",), uses_reward=True),
    Row("NRI", "_nri", "NRI", ("table2",), defined_types=False),
    Row("Supervised", "_supervised", "Supervised", ("table2",), transfers=True),
)
PRIOR_ROWS = (
    Row("GRI, flat prior", "_flat", "GRI", ("table2",), uses_reward=True),
    Row("NRI + prior", "_nri_prior", "NRI", ("table2",), defined_types=False),
)
"""Of recorded scenes. "GRI" has the structured prior, "NRI" the flat one; these rows have it the other way round."""
IDM = Row("IDM, calibrated", "_idm", None, ("table2",), calibrated=True, transfers=True)

SYNTHETIC_ROWS = (*ROWS, *EQUAL_TERMS_ROWS)
X_V, X_Y_V = ("x", "v"), ("x", "y", "v")
MIXED = "the true graph differs from scene to scene"
SCENARIOS = (
    Scenario("car_following", "Car following", "paper_car_following", X_V, SYNTHETIC_ROWS, flips=FOLLOWING_FLIPS),
    Scenario("car_following_mixed", f"Car following, {MIXED}", "paper_car_following_mixed", X_V, MIXED_ROWS),
    Scenario("lane_changing", "Lane changing", "lane_changing", X_Y_V, SYNTHETIC_ROWS, LANE_PROTOCOL, LANE_FLIPS),
    Scenario("lane_changing_mixed", f"Lane changing, {MIXED}", "lane_changing_mixed", X_Y_V, MIXED_ROWS, LANE_PROTOCOL),
    Scenario(
        "car_following_noise",
        "Car following, expert with noise",
        "paper_car_following_noise",
        X_V,
        OTHER_EXPERT_ROWS,
        flips=FOLLOWING_FLIPS,
    ),
    Scenario("car_following_idm", "Car following, IDM drivers", "paper_car_following_idm", X_V, OTHER_EXPERT_ROWS),
    Scenario(
        "ngsim_car_following",
        "Recorded car following (NGSIM)",
        "ngsim_car_following",
        X_V,
        (IDM, *RECORDED_ROWS, *PRIOR_ROWS),
        recorded=NGSIM_CAR_FOLLOWING,
    ),
    Scenario(
        "ngsim_lane_changing",
        "Recorded lane changing (NGSIM)",
        "ngsim_lane_changing",
        X_Y_V,
        (*RECORDED_ROWS, *PRIOR_ROWS),
        recorded=NGSIM_LANE_CHANGING,
        cross_validation=CrossValidation(),
    ),
)


def config_of(scenario: Scenario, row: Row) -> TrainConfig | None:
    """The row's training configuration; None where the project has none."""
    path = resources.shipped("scenarios", "train", f"{scenario.prefix}{row.suffix}.yaml")
    return read_train_config(path) if path.is_file() else None


def rows_of(scenario: Scenario, table: str) -> tuple[Row, ...]:
    """The rows of one table that can be made: those with a configuration, and calibrated ones."""
    return tuple(row for row in scenario.rows if table in row.tables and (row.calibrated or config_of(scenario, row)))


class PublishedRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row as the paper prints it: mean and standard deviation of each score."""

    x: tuple[float, float]
    v: tuple[float, float]
    y: tuple[float, float] | None = None
    accuracy: tuple[float, float] | None = None


@cache
def published_rows() -> dict[str, dict[str, PublishedRow]]:
    """The paper's rows by name, for the two synthetic scenarios and the two recorded ones that it has."""
    path = resources.PACKAGE / "paper/published.yaml"
    return checked(parsed(path), dict[str, dict[str, PublishedRow]], path)


def published_row(scenario: Scenario, row: Row | None) -> PublishedRow | None:
    """The paper's figures beside a row, if it prints any."""
    return published_rows().get(scenario.name, {}).get((row and row.published) or "")
