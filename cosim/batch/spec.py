"""Batch: the frozen, typed specification of many runs as a matrix.

A batch is a YAML file. Its runs are scenarios × policies × (nominal + perturbations × intensities) × variants × seeds,
without those that `exclude` matches, plus those that `include` lists. `cosim.batch.run_matrix` turns it into single,
checked scenarios.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

from cosim.spec.demand import Name, Place, PositivePeriod, Spec, Text
from cosim.spec.scenario import Driver, Seed

Intensities = Annotated[tuple[float, ...], Meta(min_length=1, max_length=1000)]
MOST_SEEDS = 100_000
NOMINAL = "nominal"  # name of the perturbation of a run without one
PLAIN = "plain"  # name of the variant of a run without one
LEFT_TO_SUMO = "left to SUMO"  # name of the policy of the counterparts


class Sweep(Spec, frozen=True, kw_only=True):
    """One kind of perturbation at several intensities; `settings` are the other fields of the perturbation."""

    kind: str
    intensities: Intensities
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if repeated := _repeated(self.intensities):
            raise ValueError(f"intensities has {repeated[0]:g} twice, expected each intensity once")


class Seeds(Spec, frozen=True, kw_only=True):
    """`count` consecutive seeds, beginning with `first`."""

    first: Seed = 1
    count: Annotated[int, Meta(ge=1, le=MOST_SEEDS)]

    def __post_init__(self) -> None:
        if self.first + self.count > 2**31:
            raise ValueError(
                f"the last of {self.count} seeds from {self.first} is {self.first + self.count - 1}, but SUMO's seeds"
                f" are below {2**31}; expected a smaller first or count"
            )


class ExtraRun(Spec, frozen=True, kw_only=True):
    """One more run, by the names in the matrix.

    Without a policy or a seed it has those of its scenario; without a perturbation it is nominal, without a variant it
    is plain.
    """

    scenario: str
    policy: str | None = None
    perturbation: str | None = None
    intensity: float | None = None
    variant: str | None = None
    seed: Seed | None = None


class Exclusion(Spec, frozen=True, kw_only=True):
    """Leaves out every run of the matrix that has all the values given here."""

    scenario: str | None = None
    policy: str | None = None
    perturbation: str | None = None
    intensity: float | None = None
    variant: str | None = None
    seed: Seed | None = None


Kept = Literal["all"] | tuple[Name, ...]  # columns of a table


class MoreTables(Spec, frozen=True, kw_only=True):
    """Tables that shards keep besides those of which results are made: a list of columns each, or `all`."""

    steps: Kept | None = None
    events: Kept | None = None
    graphs: Kept | None = None
    surroundings: Kept | None = None
    vehicles: Kept | None = None
    space_time: Kept | None = None
    incidents: Kept | None = None
    pair_graphs: Kept | None = None
    samples: Kept | None = None

    def kept(self) -> dict[str, Kept]:
        """The columns of each table that is kept."""
        return {name: columns for name, columns in msgspec.structs.asdict(self).items() if columns is not None}


class Shards(Spec, frozen=True, kw_only=True):
    """Results of finished runs are packed: one file per table for `runs` runs, instead of a folder per run.

    A shard has the tables that results and reports are made from: `groups` and `counterparts`, or `traffic`. `tables`
    names others to keep.
    """

    runs: Annotated[int, Meta(ge=1, le=100_000)] = 500
    tables: MoreTables = MoreTables()


def _repeated(values: Sequence[float] | Sequence[int]) -> list[float]:
    """The values that a list has more than once."""
    return [value for value, count in Counter(values).items() if count > 1]


class Batch(Spec, frozen=True, kw_only=True):
    """Many runs. `time_limit` is the wall-clock time per run [s]; a run that died is repeated up to `retries` times.

    `policies` default to the policy of each scenario, `seeds` to its seed. `overrides` change fields of all scenarios.
    Each of the `variants` is a further set of such changes, and one value on an axis of the matrix. With `shards` the
    results take few files (large batches); without, every run has a folder.
    """

    description: Text = ""
    scenarios: Annotated[tuple[Place, ...], Meta(min_length=1)]
    policies: dict[Name, Driver] = field(default_factory=dict)
    nominal: bool = True
    perturbations: dict[Name, Sweep] = field(default_factory=dict)
    seeds: Annotated[tuple[Seed, ...], Meta(min_length=1)] | Seeds | None = None
    overrides: dict[str, Any] = field(default_factory=dict)
    variants: dict[Name, dict[str, Any]] = field(default_factory=dict)
    include: tuple[ExtraRun, ...] = ()
    exclude: tuple[Exclusion, ...] = ()
    time_limit: PositivePeriod = 900.0
    retries: Annotated[int, Meta(ge=0, le=100)] = 1
    shards: Shards | None = None

    def __post_init__(self) -> None:
        for name, taken in ((NOMINAL, self.perturbations), (PLAIN, self.variants)):
            if name in taken:
                raise ValueError(f"the name {name!r} is reserved for runs without one, expected another name")
        if not self.nominal and not self.perturbations:
            raise ValueError("nominal is false and there are no perturbations, expected at least one of the two")
        if isinstance(self.seeds, tuple) and (repeated := _repeated(self.seeds)):
            raise ValueError(f"seeds has {repeated[0]} twice, expected each seed once")

    def seed_list(self) -> tuple[int, ...] | None:
        """The seeds of the matrix; None: the seed of each scenario."""
        if isinstance(self.seeds, Seeds):
            return tuple(range(self.seeds.first, self.seeds.first + self.seeds.count))
        return self.seeds


def json_schema() -> dict[str, Any]:
    """JSON Schema of a batch file, for editors."""
    schema = msgspec.json.schema(Batch)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "cosim batch", **schema}
