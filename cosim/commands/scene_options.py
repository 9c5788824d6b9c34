"""Turn the options of `cosim scenes` into a scenario, kinds and rules; every mistake is an `InputError`."""

import re
from collections.abc import Sequence
from typing import Any, get_args

import msgspec

from cosim.scenes.scene_rules import ANY_SIZE, DEFAULT_KINDS, DT, KINDS, Kind, Rules
from cosim.spec.demand import CarFollowingModel
from cosim.spec.loading import override
from cosim.spec.scenario import USUAL_SIZE, Scenario, SimulatedTraffic
from gri.errors import InputError


def changed(scenario: Scenario, name: str, step: float | None) -> Scenario:
    """The scenario with another step [s].

    Raises:
        InputError: the step does not divide the period of scenes, or the background is a recording.
    """
    if not isinstance(scenario.background, SimulatedTraffic):
        raise InputError(
            f"{name}: got a scenario whose background is a recording; cut its scenes with `gri ngsim scenes`"
        )
    step = scenario.step if step is None else step
    every = DT / step if step > 0 else 0.0
    if every < 1 - 1e-9 or abs(every - round(every)) > 1e-6:
        raise InputError(f"got a step of {step:g} s, wanted one of which {DT} s is a multiple; give --step")
    return override(scenario, {"step": step})


def with_car_following(scenario: Scenario, model: str | None) -> Scenario:
    """The scenario in which all drivers have another car-following model, as precise as the model can be.

    Raises:
        InputError: the model is unknown.
    """
    if model is None:
        return scenario
    known = get_args(CarFollowingModel)
    if model not in known:
        raise InputError(f"--car-following: got {model!r}, wanted {', '.join(known)}")
    changes: dict[str, Any] = {"car_following": model} | ({} if model == "Krauss" else {"imperfection": None})
    vehicles = tuple(msgspec.structs.replace(of, **changes) for of in scenario.traffic.vehicles)
    return msgspec.structs.replace(scenario, traffic=msgspec.structs.replace(scenario.traffic, vehicles=vehicles))


def kinds_of(names: Sequence[str] | None, size: int = USUAL_SIZE) -> tuple[Kind, ...]:
    """The named kinds, each once; where no name is given, car following, and merges of groups of three.

    Raises:
        InputError: a kind is unknown, or has always three vehicles while `size` is another number.
    """
    for name in names or ():
        if name not in KINDS:
            raise InputError(f"--kind: got {name!r}, wanted one of {', '.join(KINDS)}")
        if size != USUAL_SIZE and name not in ANY_SIZE:
            raise InputError(
                f"--kind: got {name} for group.size {size}, but a {name} has three vehicles; set group.size to 3, or"
                f" give --kind {ANY_SIZE[0]}"
            )
    wanted = names or (DEFAULT_KINDS if size == USUAL_SIZE else ANY_SIZE)
    return tuple(kind for kind in KINDS if kind in wanted)


def rules_of(*, at_most: Sequence[str], **changes: Any) -> Rules:
    """The rules with the options that were given; `at_most` holds texts TYPE=SHARE."""
    shares: dict[str, str] = {}
    for text in at_most:
        kind, _, share = text.partition("=")
        shares[kind] = share
    given = {name: value for name, value in changes.items() if value is not None}
    try:
        return msgspec.convert(given | {"at_most": shares}, Rules, strict=False).checked()
    except msgspec.ValidationError as error:
        problem, _, location = str(error).partition(" - at ")
        field = re.search(r"\$\.(\w+)", location)
        raise InputError(f"--{field[1].replace('_', '-') if field else 'at-most'}: {problem}") from None
