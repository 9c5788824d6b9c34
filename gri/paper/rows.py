"""What the tables and figures are made of: scenarios and their rows, as data.

A row is a training configuration that comes with the project, `scenarios/train/PREFIX + suffix.yaml`. A row
whose file does not exist is left out, so that a scenario grows by adding files.
"""

from dataclasses import dataclass
from functools import cache

import msgspec

from gri import resources
from gri.config import read_yaml
from gri.core.graph import EdgeType
from gri.evaluation.diagnostics import Flip
from gri.evaluation.out_of_distribution import Protocol
from gri.training.train import TrainConfig, read_train_config


@dataclass(frozen=True)
class Row:
    """One model of a table."""

    name: str
    suffix: str
    printed: str | None
    """The paper's row it stands beside."""
    tables: tuple[str, ...] = ("table1",)
    meaning: bool = True
    """Its edge types have the meaning of the definitions; else tests force the types it infers itself."""


@dataclass(frozen=True)
class Scenario:
    """A kind of scene, its rows, and its test out of distribution."""

    name: str
    title: str
    prefix: str
    features: tuple[str, ...]
    protocol: Protocol
    paper: str
    """Its section in published.yaml."""
    rows: tuple[Row, ...]
    flips: tuple[Flip, ...] = ()


NONE, FOLLOW, YIELD, CUT_IN = EdgeType
FOLLOWING_FLIPS = (Flip(1, 0, NONE, FOLLOW, "headway"),)
LANE_FLIPS = (
    Flip(2, 0, NONE, FOLLOW, "headway"),
    Flip(2, 0, NONE, FOLLOW, "lateral"),
    Flip(2, 0, FOLLOW, YIELD, "lateral"),
    Flip(0, 1, YIELD, CUT_IN, "headway"),
    Flip(0, 1, YIELD, CUT_IN, "order"),
)
GRI = Row("GRI", "", "GRI", ("table1", "table3", "ood"))
SUPERVISED = Row("Supervised", "_supervised", "Supervised", ("table1", "ood"))
ROWS = (
    GRI,
    Row("GRI (paper, contrast)", "_airl", "GRI", ("table1", "table3", "ood")),
    Row("GRI (paper, literal)", "_airl_literal", "GRI", ("table1", "ood")),
    Row("NRI", "_nri", "NRI", ("table1", "ood"), meaning=False),
    Row("NRI, type 0 speaks", "_nri_type0", "NRI", ("table1", "ood"), meaning=False),
    SUPERVISED,
    Row("GRI, recurrent decoder", "_recurrent", "GRI", ("table1",)),
    Row("GRI, tested range held out", "_strict", "GRI", ("ood",)),
    Row("GRI-VAIRL", "_gri_vairl", "GRI-VAIRL", ("table3", "ood"), meaning=False),
    Row("GRI-AIRL", "_gri_airl", "GRI-AIRL", ("table3", "ood"), meaning=False),
)
MIXED_ROWS = (Row("GRI", "", None), Row("GRI (paper, contrast)", "_airl", None), Row("Supervised", "_supervised", None))
LANE_PROTOCOL = Protocol(headways=tuple(float(x) for x in range(8, -9, -1)), kept=(0, 2))

SCENARIOS = (
    Scenario(
        "car_following",
        "Car following",
        "paper_car_following",
        ("x", "v"),
        Protocol(),
        "car_following",
        ROWS,
        FOLLOWING_FLIPS,
    ),
    Scenario(
        "car_following_mixed",
        "Car following, the true graph differs from scene to scene",
        "paper_car_following_mixed",
        ("x", "v"),
        Protocol(),
        "",
        MIXED_ROWS,
    ),
    Scenario(
        "lane_changing",
        "Lane changing",
        "lane_changing",
        ("x", "y", "v"),
        LANE_PROTOCOL,
        "lane_changing",
        ROWS,
        LANE_FLIPS,
    ),
    Scenario(
        "lane_changing_mixed",
        "Lane changing, the true graph differs from scene to scene",
        "lane_changing_mixed",
        ("x", "y", "v"),
        LANE_PROTOCOL,
        "",
        MIXED_ROWS,
    ),
)


def config_of(scenario: Scenario, row: Row) -> TrainConfig | None:
    """The row's training configuration; None where the project has none."""
    path = resources.shipped("scenarios", "train", f"{scenario.prefix}{row.suffix}.yaml")
    return read_train_config(path) if path.is_file() else None


def rows_of(scenario: Scenario, table: str) -> tuple[Row, ...]:
    """The rows of one table for which there is a configuration."""
    return tuple(row for row in scenario.rows if table in row.tables and config_of(scenario, row))


def scenario_named(name: str) -> Scenario:
    """A scenario by its name."""
    return next(scenario for scenario in SCENARIOS if scenario.name == name)


class Printed(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row as the paper prints it: mean and standard deviation."""

    x: tuple[float, float]
    v: tuple[float, float]
    y: tuple[float, float] | None = None
    accuracy: tuple[float, float] | None = None


class Paper(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The printed rows of the two synthetic scenarios and of the two recorded ones."""

    car_following: dict[str, Printed]
    lane_changing: dict[str, Printed]
    ngsim_car_following: dict[str, Printed]
    ngsim_lane_changing: dict[str, Printed]


@cache
def printed() -> dict[str, dict[str, Printed]]:
    """The paper's figures by scenario and row."""
    return msgspec.structs.asdict(read_yaml(resources.PACKAGE / "paper/published.yaml", Paper))
