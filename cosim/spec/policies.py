"""What may drive the groups: trained, simple, reference and own policies, and the filter of their actions."""

from typing import Annotated, Any, Literal

from msgspec import Meta, field

from cosim.spec.demand import Place, Spec
from cosim.spec.sumo_models import SumoModel

DECISION_LIMIT = 30.0  # [s] of real time for one decision of a policy of the user


class TrainedPolicy(Spec, frozen=True, kw_only=True, tag_field="kind", tag="gri"):
    """A trained policy: the name of a released checkpoint, or the path of one.

    It sees its `group`, under the graph. One that sees `everybody` also follows whoever is next ahead in its lane, in
    the group or not (docs/groups-that-change.md).
    """

    checkpoint: Place
    sees: Literal["group", "everybody"] = "group"


class Idm(Spec, frozen=True, kw_only=True, tag_field="kind", tag="idm"):
    """The intelligent driver model. It sees `everybody` near, or its own `group` only."""

    sees: Literal["everybody", "group"] = "everybody"


class ConstantVelocity(Spec, frozen=True, kw_only=True, tag_field="kind", tag="constant_velocity"):
    """Drives on with the speed at the take-over."""


class R157(Spec, frozen=True, kw_only=True, tag_field="kind", tag="r157"):
    """The reference driver of UN Regulation 157, paragraph 5.2.5.2, on top of `idm` (docs/cut-ins.md)."""


class CarefulHuman(Spec, frozen=True, kw_only=True, tag_field="kind", tag="careful_human"):
    """The competent and careful human driver of UN Regulation 157, Annex 3, on top of `idm`.

    It perceives a cut-in once the vehicles overlap sideways, or once the other leaves its lane (`wandering`).
    """

    variant: Literal["overlap", "wandering"] = "overlap"


class Fsm(Spec, frozen=True, kw_only=True, tag_field="kind", tag="fsm"):
    """The driver of the fuzzy surrogate safety metrics, UN Regulation 157, Annex 3, on top of `idm`."""


class Rss(Spec, frozen=True, kw_only=True, tag_field="kind", tag="rss"):
    """A driver by responsibility-sensitive safety, on top of `idm`."""


class LeftToSumo(Spec, frozen=True, kw_only=True, tag_field="kind", tag="sumo"):
    """No take-over: SUMO drives the group (null run)."""


class SumoDriver(Spec, frozen=True, kw_only=True, tag_field="kind", tag="sumo_driver"):
    """In a replay: SUMO's drivers, as `traffic` describes them, drive the group instead of its recording.

    They keep their lanes. Vehicle classes with `car_following: EIDM` or `IDM` make them drive by these models.
    """


class UserPolicy(Spec, frozen=True, kw_only=True, tag_field="kind", tag="python"):
    """A policy of the user: `object` is "file.py:Name" or "package.module:Name".

    This runs code: the file is imported when a run starts. Use only files that you trust. A file outside the folder of
    the scenario or batch, and a module, need the option `--allow-code`.

    The object is called with the time step dt [s] and the `settings`, and must return a `gri.core.policy.Policy`, which
    may take `decision_limit` [s] for one decision. docs/tutorial.md has an example.
    """

    object: Annotated[str, Meta(pattern=r"^[^:]+:[A-Za-z_][A-Za-z0-9_]*$", max_length=1000)]
    settings: dict[str, Any] = field(default_factory=dict)
    decision_limit: Annotated[float, Meta(ge=0.01, le=3600)] = DECISION_LIMIT


ReferencePolicy = R157 | CarefulHuman | Fsm | Rss
Driver = (
    TrainedPolicy
    | Idm
    | ConstantVelocity
    | R157
    | CarefulHuman
    | Fsm
    | Rss
    | LeftToSumo
    | SumoDriver
    | UserPolicy
    | SumoModel
)


class RssFilter(Spec, frozen=True, kw_only=True, tag_field="kind", tag="rss"):
    """A filter of the policy's actions by responsibility-sensitive safety (RSS).

    Along the road, a driven vehicle must be able to stop `margin` [m] behind whoever is next ahead in its path, in or
    out of the group, if that one brakes by `other_braking` and it brakes itself by `braking` [m/s²]. Across the road,
    it moves no closer than `margin_across` [m] to an occupied place, and stays on the road; where it may not move over,
    it is steered back to its lane. A merge gets help if the lane ends within `merge_within` [s]: vehicles make room,
    the filter moves over where the policy has hesitated for `patience` [s] although there was room, and stops before
    the end of the lane where there is none. 0: no help. The filter knows the true states, whatever perturbs the
    policy's sensors.
    """

    braking: Annotated[float, Meta(ge=1, le=12)] = 8.0
    other_braking: Annotated[float, Meta(ge=1, le=12)] = 8.0
    margin: Annotated[float, Meta(ge=0, le=20)] = 1.0
    margin_across: Annotated[float, Meta(ge=0, le=5)] = 0.5
    merge_within: Annotated[float, Meta(ge=0, le=60)] = 10.0
    patience: Annotated[float, Meta(ge=0, le=60)] = 2.0
