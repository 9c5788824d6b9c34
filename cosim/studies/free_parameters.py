"""The numbers of a traffic description that a calibration may change, by name."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from msgspec.structs import replace

from cosim.spec.demand import Bottleneck, Traffic
from gri.errors import InputError

OF_DRIVERS = ("tau", "tau_cv", "imperfection", "acceleration", "min_gap", "speed_factor_sd")
OF_LANE_CHANGING = ("strategic", "cooperative", "speed_gain", "assertive")
OF_BOTTLENECK = {
    "fluctuation": ("sd", "correlation_time", "lane_correlation", "period"),
    "pulses": ("duration", "period", "limit"),
}
SHARES = ("imperfection", "cooperative", "lane_correlation")
"""Numbers that are 1 at most."""


@dataclass(frozen=True)
class Parameter:
    """A free number of a traffic description.

    `tau`, `speed_gain` and others of drivers change in all vehicle classes by one factor, as `limit` does in all demand
    intervals; `limit.K` is the K-th limit alone. `fluctuation.sd` and the like are those of the bottleneck.
    """

    name: str

    @property
    def interval(self) -> int | None:
        """The demand interval (0-based) whose limit this is; None for all."""
        head, _, number = self.name.partition(".")
        return int(number) - 1 if head == "limit" and number else None

    def value_in(self, traffic: Traffic) -> float:
        """Its value; the first one that is not 0 where it scales several."""
        found = [value for value in self._values(traffic) if value]
        return found[0] if found else 0.0

    def _values(self, traffic: Traffic) -> list[float]:
        if self.name in OF_DRIVERS:
            return [getattr(vehicles, self.name) or 0.0 for vehicles in traffic.vehicles]
        if self.name in OF_LANE_CHANGING:
            return [getattr(vehicles.lane_changing, self.name) for vehicles in traffic.vehicles]
        bottleneck = traffic.bottleneck
        assert bottleneck is not None, "checked by `parameters`"
        part, _, name = self.name.partition(".")
        if part == "limit":
            return [bottleneck.limits[self.interval or 0]]
        return [getattr(getattr(bottleneck, part), name) or 0.0]

    def replaced_in(self, traffic: Traffic, value: float) -> Traffic:
        """The traffic with this value of the parameter; others that it scales change by the same factor."""
        factor = value / self.value_in(traffic)
        if self.name in (*OF_DRIVERS, *OF_LANE_CHANGING):
            return self._with_drivers(traffic, lambda old: self._rounded(old * factor))
        assert traffic.bottleneck is not None, "checked by `parameters`"
        return replace(traffic, bottleneck=self._of_bottleneck(traffic.bottleneck, factor, value))

    def _with_drivers(self, traffic: Traffic, change: Callable[[float], float]) -> Traffic:
        vehicles = []
        for kind in traffic.vehicles:
            holder = kind if self.name in OF_DRIVERS else kind.lane_changing
            old = getattr(holder, self.name)
            new = holder if old is None else replace(holder, **{self.name: change(old)})
            vehicles.append(new if holder is kind else replace(kind, lane_changing=new))
        return replace(traffic, vehicles=tuple(vehicles))

    def _of_bottleneck(self, bottleneck: Bottleneck, factor: float, value: float) -> Bottleneck:
        part, _, name = self.name.partition(".")
        if part != "limit":
            changed = replace(getattr(bottleneck, part), **{name: self._rounded(value)})
            return replace(bottleneck, **{part: changed})
        limits = tuple(
            round(limit * factor, 3) if self.interval in (None, k) else limit
            for k, limit in enumerate(bottleneck.limits)
        )
        return replace(bottleneck, limits=limits)

    def _rounded(self, value: float) -> float:
        share = self.name.rpartition(".")[2] in SHARES
        return round(min(value, 1.0) if share else value, 4)


def parameters(names: Sequence[str], traffic: Traffic) -> tuple[Parameter, ...]:
    """The named parameters. Raises `InputError` for a name that this traffic does not have."""
    known = known_names(traffic)
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"--free: got {unknown[0]!r}, this traffic has {', '.join(known)}")
    return tuple(Parameter(name) for name in names)


def known_names(traffic: Traffic) -> list[str]:
    """The names of all parameters whose value in this traffic is not 0."""
    bottleneck = traffic.bottleneck
    intervals = len(bottleneck.limits) if bottleneck else 0
    names = [*OF_DRIVERS, *OF_LANE_CHANGING, *(["limit"] if intervals else [])]
    names += [f"limit.{k + 1}" for k in range(intervals)]
    for part, of_part in OF_BOTTLENECK.items():
        if getattr(bottleneck, part, None) is not None:
            names += [f"{part}.{name}" for name in of_part]
    return [name for name in names if Parameter(name).value_in(traffic)]
