"""What a stress test does: policies × (nominal + perturbations × intensities), in chunks that share a warm-up.

All perturbations of what happens at or after the take-over start from the same undisturbed traffic, so one warmed-up
simulation serves all of them; those of the traffic itself need a simulation each, and have other starts.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.spec.input_files import checkpoint_path, find_net, sha256
from cosim.spec.loading import override
from cosim.spec.perturbations import KINDS, AggressiveDrivers, DenserDemand, LowFriction, MoreTrucks
from cosim.spec.scenario import CarFollowing, ConstantVelocity, Driver, Idm, LeftToSumo, Scenario, Trained
from gri.errors import InputError

FORMAT = 3  # of a chunk's rows; a new number computes every chunk again
NOMINAL = "nominal"
STARTS_PER_CHUNK = 10
GROUPS_AT_ONCE = 12
PACKAGES = ("gri-cosim", "libsumo", "numpy", "torch")  # whose versions a chunk depends on
OF_TRAFFIC = tuple(
    str(kind.__struct_config__.tag) for kind in (DenserDemand, MoreTrucks, AggressiveDrivers, LowFriction)
)
ONE_LANE = {"headway_ratio": (0.15, 0.3, 0.45, 0.6, 0.7)}  # default intensities where δ ≥ 1 is impossible
BASELINES: dict[str, Driver] = {"idm": Idm(), "constant_velocity": ConstantVelocity(), "sumo": LeftToSumo()}


@dataclass(frozen=True)
class Cell:
    """One perturbation at one intensity; the nominal one has neither."""

    perturbation: str = NOMINAL
    intensity: float | None = None


class Chunk(Struct, frozen=True):
    """A part of a stress test that runs in one simulation: `starts` groups, each driven by all policies in all cells.

    The scenario has the seed and, if its only cell is one of the traffic, that traffic.
    """

    scenario: Scenario
    policies: dict[str, Driver]
    cells: tuple[Cell, ...]
    starts: int

    @property
    def key(self) -> str:
        """Hash of all that the chunk's rows depend on."""
        used = {name: driver.checkpoint for name, driver in self.policies.items() if isinstance(driver, Trained)}
        facts = {
            "format": FORMAT,
            "chunk": msgspec.to_builtins(replace(self, scenario=replace(self.scenario, description=""))),
            "net": sha256(find_net(self.scenario.net)),
            "checkpoints": {name: sha256(checkpoint_path(file)) for name, file in used.items()},
            "versions": {name: version(name) for name in PACKAGES},
        }
        return hashlib.sha256(msgspec.json.encode(facts, order="sorted")).hexdigest()[:12]

    @property
    def parts(self) -> tuple["Chunk", ...]:
        """The chunk by kind of perturbation and policy, whose rows are kept apart: who adds a policy or a kind to a
        stress test need not drive the others again.
        """
        kinds = dict.fromkeys(cell.perturbation for cell in self.cells)
        return tuple(
            replace(self, policies={name: driver}, cells=tuple(c for c in self.cells if c.perturbation == kind))
            for kind in kinds
            for name, driver in self.policies.items()
        )

    def around(self, parts: Sequence["Chunk"]) -> "Chunk":
        """The smallest chunk that has all these parts of it."""
        names, cells = {name for part in parts for name in part.policies}, {c for part in parts for c in part.cells}
        return replace(
            self,
            policies={name: driver for name, driver in self.policies.items() if name in names},
            cells=tuple(cell for cell in self.cells if cell in cells),
        )


def perturbed(scenario: Scenario, cell: Cell) -> Scenario:
    """The scenario with the cell's perturbation (and none of its own), checked; the traffic is left as it is."""
    block = [] if cell.intensity is None else [{"kind": cell.perturbation, "intensity": cell.intensity}]
    return override(scenario, {"perturbations": block})


def chunks(
    scenario: Scenario, policies: Mapping[str, Driver], sweeps: Mapping[str, Sequence[float]], starts: int
) -> tuple[Chunk, ...]:
    """The parts of a stress test; the i-th block of STARTS_PER_CHUNK starts has the scenario's seed + i.

    Nobody is watched after the drive, and as many groups as there are without meeting are taken at once.
    """
    scenario = replace(scenario, watch=0.0, groups_at_once=GROUPS_AT_ONCE)
    graded = [Cell(kind, float(x)) for kind, intensities in sweeps.items() for x in intensities]
    shared = (Cell(), *(cell for cell in graded if cell.perturbation not in OF_TRAFFIC))
    found = []
    for i, first in enumerate(range(0, starts, STARTS_PER_CHUNK)):
        seeded, count = replace(scenario, seed=scenario.seed + i), min(STARTS_PER_CHUNK, starts - first)
        for cell in shared:
            perturbed(seeded, cell)  # refuses intensities out of range
        found.append(Chunk(seeded, dict(policies), shared, count))
        for cell in graded:
            if cell.perturbation in OF_TRAFFIC:
                own = replace(perturbed_traffic(perturbed(seeded, cell)), perturbations=())
                found.append(Chunk(own, dict(policies), (cell,), count))
    return tuple(found)


def sweeps_of(kinds: Sequence[str], intensities: Sequence[float], scenario: Scenario) -> dict[str, tuple[float, ...]]:
    """The intensities of each kind of perturbation: those given, or the kind's own."""
    own = ONE_LANE if isinstance(scenario.group, CarFollowing) else {}
    for kind in kinds:
        if kind not in KINDS:
            raise InputError(f"--perturbation: unknown kind {kind!r}; the kinds are {', '.join(KINDS)}")
    if intensities and len(kinds) > 1:
        raise InputError(f"--intensity: got {len(kinds)} perturbations, whose intensities differ; give one of them")
    return {kind: tuple(intensities) or own.get(kind, KINDS[kind].grades) for kind in kinds}


def policies_of(names: Sequence[str], scenario: Scenario) -> dict[str, Driver]:
    """The drivers that names mean: a baseline, a released checkpoint or a path.

    `gri` is the scenario's own checkpoint, another word like `supervised` the one that has it behind that name.
    """
    found: dict[str, Driver] = {}
    for name in names:
        if name in BASELINES:
            found[name] = BASELINES[name]
            continue
        candidates = [name]
        if isinstance(scenario.policy, Trained):
            own = scenario.policy.checkpoint
            candidates.append(own if name == "gri" else f"{own}_{name}")
        known = [candidate for candidate in candidates if _exists(candidate)]
        checkpoint = known[0] if known else name
        checkpoint_path(checkpoint)  # refuses what is not there
        found[name.removesuffix(".pt").rpartition("/")[2]] = Trained(checkpoint=checkpoint)
    if len(found) < len(names):
        raise InputError(f"--policy: got {', '.join(names)}, expected each policy once, by different names")
    return found


def _exists(checkpoint: str) -> bool:
    try:
        return checkpoint_path(checkpoint).is_file()
    except InputError:
        return False
