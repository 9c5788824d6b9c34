"""SUMO's own car-following models as policies of a share of the traffic.

SUMO doc: Definition of Vehicles, Vehicle Types, and Routes; Car-Following Models.
"""

from typing import Annotated, Literal

from msgspec import Meta, field

from cosim.spec.demand import Name, Spec

ModelName = Literal["ACC", "CACC", "IDM", "EIDM", "W99", "Krauss"]
_EVERY = ("accel", "decel", "emergencyDecel", "tau", "minGap")
_ACC = (
    "speedControlGain",
    "gapClosingControlGainSpeed",
    "gapClosingControlGainSpace",
    "gapControlGainSpeed",
    "gapControlGainSpace",
    "collisionAvoidanceGainSpeed",
    "collisionAvoidanceGainSpace",
    "collisionAvoidanceOverride",
)
_CACC = (
    "speedControlGainCACC",
    "gapClosingControlGainGap",
    "gapClosingControlGainGapDot",
    "gapControlGainGap",
    "gapControlGainGapDot",
    "collisionAvoidanceGainGap",
    "collisionAvoidanceGainGapDot",
    "headwayTimeCACCToACC",
)
PARAMETERS: dict[str, tuple[str, ...]] = {
    "Krauss": ("sigma",),
    "IDM": ("delta", "stepping"),
    "EIDM": ("delta", "stepping", "tpreview", "tPersDrive", "treaction", "sigmaleader", "sigmagap", "sigmaerror"),
    "ACC": _ACC,
    "CACC": (*_ACC, *_CACC),
    "W99": tuple(f"cc{k}" for k in range(1, 10)),
}
"""Attributes of SUMO's vehicle types that each model reads besides those that every model reads."""


class SumoModel(Spec, frozen=True, kw_only=True, tag_field="kind", tag="sumo_model"):
    """One of SUMO's own car-following models: adaptive cruise control (ACC, CACC), IDM, EIDM, Wiedemann 99, Krauss.

    For a share of the traffic only. A vehicle keeps its body, its speed factor and its lane changing. It also keeps
    acceleration, deceleration, time headway and minimum gap, unless `parameters` replace them. They are attributes of
    SUMO's vehicle types, such as `tau` [s] or `minGap` [m]; those of the model itself have SUMO's defaults. W99 takes
    its headway from `cc1` [s], not from `tau`.
    """

    model: ModelName
    parameters: dict[Name, Annotated[float, Meta(ge=-1000, le=1000)]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = (*_EVERY, *PARAMETERS[self.model])
        if unknown := [name for name in self.parameters if name not in known]:
            raise ValueError(f"parameters has {unknown[0]!r}, but {self.model} reads only {', '.join(known)}")
