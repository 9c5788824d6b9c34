"""The plan of a stress test: policies × (nominal + perturbations × intensities), in chunks that share a warm-up.

Perturbations that act at or after the take-over start from the same undisturbed traffic, so that one warmed-up
simulation serves all of them. Perturbations of the traffic itself need a simulation each and have other starts.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.runs.policy_fit import seen_like
from cosim.spec.demand import Traffic
from cosim.spec.input_files import checkpoint_path, files_of_policy, find_net, sha256
from cosim.spec.loading import override
from cosim.spec.perturbations import CHANGES_DEMAND, KINDS, RENAMED
from cosim.spec.scenario import (
    AFTERMATH,
    R157,
    USUAL_SIZE,
    CarefulHuman,
    CarFollowing,
    ConstantVelocity,
    Driver,
    Fsm,
    Idm,
    LeftToSumo,
    Replay,
    Rss,
    RssFilter,
    Scenario,
    TrainedPolicy,
    UserPolicy,
    tag_of,
)
from gri.errors import InputError

FORMAT = 8  # of the rows of a chunk; with a new number every chunk is computed again
NOMINAL = "nominal"
STARTS_PER_CHUNK = 10
GROUPS_AT_ONCE = 12
PACKAGES = ("gri-cosim", "libsumo", "numpy", "torch")  # whose versions a chunk depends on
TRAFFIC_KINDS = tuple(str(kind.__struct_config__.tag) for kind in CHANGES_DEMAND)
ONE_LANE_INTENSITIES = {"headway_ratio": (0.15, 0.3, 0.45, 0.6, 0.7)}  # default intensities where δ ≥ 1 is impossible
ALL = "all"  # in place of a kind of perturbation: all that make sense for the scenario
LEVELS_OF_ALL = 2  # intensities of each kind, if all kinds are wanted
REINFER = 1.0  # [s] between two inferences of the graph, if the scenario does not infer again
BASELINES: dict[str, Driver] = {
    "idm": Idm(),
    "constant_velocity": ConstantVelocity(),
    "r157": R157(),
    "careful_human": CarefulHuman(),
    "careful_human_wandering": CarefulHuman(variant="wandering"),
    "fsm": Fsm(),
    "rss": Rss(),
    "sumo": LeftToSumo(),
}
OWN = "own"
"""The name of the policy of a scenario that names code (`kind: python`)."""
FILTERED, PREDICTING, AHEAD = "rss", "predict", "ahead"
"""With a + after the name of a policy: the safety filter, the state predictor, `sees: everybody` of a trained one."""


@dataclass(frozen=True)
class Cell:
    """One perturbation at one intensity; the nominal cell has no intensity."""

    perturbation: str = NOMINAL
    intensity: float | None = None


class Chunk(Struct, frozen=True):
    """A part of a stress test that runs in one simulation: `starts` groups, each driven by all policies in all cells.

    The scenario has the seed of the chunk. If the only cell is a perturbation of traffic, it has that traffic, too, and
    `unperturbed` is the traffic without the perturbation.
    """

    scenario: Scenario
    policies: dict[str, Driver]
    cells: tuple[Cell, ...]
    starts: int
    unperturbed: Traffic | None = None

    @property
    def key(self) -> str:
        """Hash of everything on which the rows of the chunk depend."""
        used = {name: driver.checkpoint for name, driver in self.policies.items() if isinstance(driver, TrainedPolicy)}
        facts = {
            "format": FORMAT,
            "chunk": msgspec.to_builtins(replace(self, scenario=replace(self.scenario, description=""))),
            "net": sha256(find_net(self.scenario.net)),
            "checkpoints": {name: sha256(checkpoint_path(file)) for name, file in used.items()},
            "versions": {name: version(name) for name in PACKAGES},
        }
        if own := [driver for driver in self.policies.values() if isinstance(driver, UserPolicy)]:
            facts["code"] = [{what: sha256(path) for what, path in files_of_policy(one).items()} for one in own]
        return hashlib.sha256(msgspec.json.encode(facts, order="sorted")).hexdigest()[:12]

    @property
    def parts(self) -> tuple["Chunk", ...]:
        """The chunk split by kind of perturbation and policy.

        Each part has a file of its own, so that a stress test with one more policy or kind reuses the other parts.
        """
        kinds = dict.fromkeys(cell.perturbation for cell in self.cells)
        return tuple(
            replace(self, policies={name: driver}, cells=tuple(c for c in self.cells if c.perturbation == kind))
            for kind in kinds
            for name, driver in self.policies.items()
        )

    def covering(self, parts: Sequence["Chunk"]) -> "Chunk":
        """The smallest part of this chunk that covers all these parts."""
        names, cells = {name for part in parts for name in part.policies}, {c for part in parts for c in part.cells}
        return replace(
            self,
            policies={name: driver for name, driver in self.policies.items() if name in names},
            cells=tuple(cell for cell in self.cells if cell in cells),
        )


def perturbed_scenario(scenario: Scenario, cell: Cell) -> Scenario:
    """The scenario with the perturbation of the cell instead of its own ones, checked; its traffic is unchanged."""
    block = [] if cell.intensity is None else [{"kind": cell.perturbation, "intensity": cell.intensity}]
    return override(scenario, {"perturbations": block})


def chunks(
    scenario: Scenario,
    policies: Mapping[str, Driver],
    sweeps: Mapping[str, Sequence[float]],
    starts: int,
    starts_per_seed: int = STARTS_PER_CHUNK,
    reinfer_s: float | None = None,
) -> tuple[Chunk, ...]:
    """The chunks of a stress test; the i-th block of `starts_per_seed` starts has the scenario's seed + i.

    Groups are observed for AFTERMATH after the drive. Up to GROUPS_AT_ONCE groups that are far apart are driven
    together. The graph is inferred again every `reinfer_s` [s] (0: never), by default as the scenario says or every
    REINFER seconds, so that perturbed sensors reach the inference. Raises `InputError` if an intensity or `reinfer_s`
    does not fit.
    """
    if scenario.seed + starts // STARTS_PER_CHUNK >= 2**31:
        raise InputError(f"--starts: {starts} starts need seeds up to 2147483648 or more; give a smaller seed")
    changes = {"reinfer_s": scenario.reinfer_s or REINFER if reinfer_s is None else reinfer_s}
    scenario = replace(scenario, watch=AFTERMATH, groups_at_once=GROUPS_AT_ONCE, surroundings=False)
    scenario = override(scenario, changes)
    cells = [Cell(kind, float(x)) for kind, intensities in sweeps.items() for x in intensities]
    shared = (Cell(), *(cell for cell in cells if cell.perturbation not in TRAFFIC_KINDS))
    found = []
    for i, first in enumerate(range(0, starts, starts_per_seed)):
        seeded, count = replace(scenario, seed=scenario.seed + i), min(starts_per_seed, starts - first)
        for cell in shared:
            perturbed_scenario(seeded, cell)  # raises for intensities out of range
        found.append(Chunk(seeded, dict(policies), shared, count))
        for cell in cells:
            if cell.perturbation in TRAFFIC_KINDS:
                own = replace(perturbed_traffic(perturbed_scenario(seeded, cell)), perturbations=())
                found.append(Chunk(own, dict(policies), (cell,), count, seeded.traffic))
    return tuple(found)


def senseless(scenario: Scenario) -> dict[str, str]:
    """The kinds of perturbation that make no sense for a scenario, each with the reason."""
    size = scenario.group.size
    of_three = {} if size == USUAL_SIZE else {"remove_third": f"groups have {size} vehicles, not three"}
    return of_three | _senseless_in_traffic(scenario)


def _senseless_in_traffic(scenario: Scenario) -> dict[str, str]:
    if isinstance(scenario.background, Replay):
        return {kind: "the traffic is recorded" for kind in TRAFFIC_KINDS if kind != "low_friction"}
    if scenario.traffic.has_own_files:
        return dict.fromkeys(TRAFFIC_KINDS, "the traffic has SUMO files of its own")
    trucks = {vehicles.name for vehicles in scenario.traffic.vehicles if vehicles.v_class == "truck"}
    shares = [share for flow in scenario.traffic.flows for name, share in flow.classes.items() if name in trucks]
    return {} if any(0 < share < 1 for share in shares) else {"more_trucks": "no flow has trucks and other vehicles"}


def sweeps_of(
    kinds: Sequence[str], intensities: Sequence[float], scenario: Scenario, levels: int | None = None
) -> dict[str, tuple[float, ...]]:
    """The intensities of each kind of perturbation: those given, or `levels` of the defaults, the greatest included.

    A kind may bring its intensities, such as "leader_braking:4:8". ALL stands for all kinds that make sense for the
    scenario. Without `levels`, each kind has all its default intensities, with ALL it has LEVELS_OF_ALL. Raises
    `InputError` for an unknown kind, one that makes no sense, or for given intensities with several kinds, and for
    anything given twice.
    """
    own = {kind: tuple(map(_intensity, given)) for kind, *given in (word.split(":") for word in kinds) if given}
    kinds = [word.partition(":")[0] for word in kinds]
    if own and (intensities or ALL in kinds):
        other = "--intensity" if intensities else ALL
        raise InputError(f"--perturbation: got intensities of {', '.join(own)} and {other}; leave one of them out")
    for option, given in (("--perturbation", kinds), ("--intensity", intensities), *own.items()):
        if len(set(given)) < len(given):
            raise InputError(f"{option}: got {', '.join(map(str, given))[:200]}, expected each one once")
    pointless = senseless(scenario)
    if ALL in kinds:
        levels = levels or LEVELS_OF_ALL
        kinds = [kind for kind in KINDS if kind not in pointless]
    for kind in kinds:
        if kind in RENAMED:
            raise InputError(f"--perturbation: {kind!r} has been replaced by {RENAMED[kind]}")
        if kind not in KINDS:
            raise InputError(f"--perturbation: unknown kind {kind!r}; the kinds are {ALL}, {', '.join(KINDS)}")
        if kind in pointless:
            raise InputError(
                f"--perturbation: {kind} makes no sense for this scenario ({pointless[kind]}); leave it out"
            )
    if intensities and len(kinds) > 1:
        raise InputError(
            f"--intensity: got {len(kinds)} kinds of perturbation, whose intensities differ in scale; give one kind, or"
            " each kind with its own: --perturbation leader_braking:4:8,dropout:0.2"
        )
    return {
        kind: own.get(kind) or tuple(intensities) or _levels(_default_intensities(kind, scenario), levels)
        for kind in kinds
    }


def _intensity(word: str) -> float:
    """The number after a kind of perturbation."""
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"--perturbation: got {word!r} as an intensity, expected a finite number")
    return number


def _default_intensities(kind: str, scenario: Scenario) -> tuple[float, ...]:
    own = ONE_LANE_INTENSITIES if isinstance(scenario.group, CarFollowing) else {}
    return own.get(kind, KINDS[kind].default_intensities)


def _levels(intensities: tuple[float, ...], levels: int | None) -> tuple[float, ...]:
    """So many of the intensities, at equal distances in the list, the last one included."""
    n = len(intensities)
    count = min(levels or n, n)
    return tuple(intensities[n * (k + 1) // count - 1] for k in range(count))


def policies_of(names: Sequence[str], scenario: Scenario) -> dict[str, Driver]:
    """The policies by name: a baseline, a released checkpoint, or the path of a checkpoint.

    `own` is the policy of a scenario that names code. `gri` is the checkpoint C that the scenario names; another word
    W, such as `supervised`, is the checkpoint "C_W" if there is one. All see as much as the policy that the scenario
    names, if they can. Names with additions, such as `gri+predict+rss`,
    are rows of their own (`scenario_for`). Raises `InputError` for an unknown checkpoint, an addition that makes no
    sense, or a name given twice.
    """
    found: dict[str, Driver] = {}
    for whole in names:
        name, added = _parts(whole)
        if added and name == "sumo":
            raise InputError(
                f"--policy: got {whole}, but SUMO's own drivers have no filter and no predictor; write sumo"
            )
        if AHEAD in added and name in (*BASELINES, OWN):
            raise InputError(f"--policy: got {whole}, but only trained policies can be told to follow who is ahead")
        if name in BASELINES:
            found[whole] = BASELINES[name]
            continue
        if name == OWN:
            if not isinstance(scenario.policy, UserPolicy):
                raise InputError(
                    f"--policy: got {whole}, but the policy of the scenario is {tag_of(scenario.policy)}; write that,"
                    " or give a scenario with policy: {kind: python, ...}"
                )
            found[whole] = scenario.policy
            continue
        candidates = [name]
        if isinstance(scenario.policy, TrainedPolicy):
            own = scenario.policy.checkpoint
            candidates.append(own if name == "gri" else f"{own}_{name}")
        known = [candidate for candidate in candidates if _exists(candidate)]
        checkpoint = known[0] if known else name
        path = checkpoint_path(checkpoint, "--policy")  # raises if there is no such checkpoint
        short = name.removesuffix(".safetensors").rpartition("/")[2]
        sees = "everybody" if AHEAD in added else seen_like(scenario.policy, path)
        found["+".join([short, *added])] = TrainedPolicy(checkpoint=checkpoint, sees=sees)
    if len(found) < len(names):
        raise InputError(f"--policy: got {', '.join(names)}, expected each policy once, by different names")
    return found


def scenario_for(name: str, policy: Driver, scenario: Scenario) -> Scenario:
    """The scenario with the policy of that name, and with the usual filter and predictor that the name asks for."""
    _, added = _parts(name)
    safety = scenario.safety or (RssFilter() if FILTERED in added else None)
    predictor = "constant_acceleration" if PREDICTING in added else scenario.predictor
    return replace(scenario, policy=policy, safety=safety, predictor=predictor)


def _parts(whole: str) -> tuple[str, list[str]]:
    """The name of a policy without its additions, and these."""
    name, added = whole, []
    while (last := name.rpartition("+"))[2] in (FILTERED, PREDICTING, AHEAD):
        name, added = last[0], [last[2], *added]
    return name, added


def _exists(checkpoint: str) -> bool:
    try:
        return checkpoint_path(checkpoint).is_file()
    except InputError:
        return False
