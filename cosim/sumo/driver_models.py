"""Giving a vehicle another car-following model of SUMO, while its body and its lane changing stay as they are."""

import libsumo

_LANE_CHANGING = (
    "lcStrategic",
    "lcCooperative",
    "lcSpeedGain",
    "lcKeepRight",
    "lcAssertive",
    "lcLookaheadLeft",
    "lcSpeedGainRight",
    "lcImpatience",
    "lcOvertakeRight",
)
_KEPT = (
    "Accel",
    "Decel",
    "EmergencyDecel",
    "ApparentDecel",
    "Tau",
    "MinGap",
    "Length",
    "Width",
    "VehicleClass",
    "EmissionClass",
    "MaxSpeed",
    "SpeedFactor",
    "ActionStepLength",
)
_OF_ATTRIBUTE = {
    "accel": "Accel",
    "decel": "Decel",
    "emergencyDecel": "EmergencyDecel",
    "tau": "Tau",
    "minGap": "MinGap",
}


def use_model(vehicle: str, kind: str, replaced: frozenset[str]) -> None:
    """Let a vehicle drive by the model of the vehicle type `kind` from now on.

    Body, class, limits and lane-change parameters stay those of the vehicle, except for the attributes in `replaced`,
    which the type gives.
    """
    api = libsumo.vehicle
    of_type = {_OF_ATTRIBUTE[name] for name in replaced if name in _OF_ATTRIBUTE}
    kept = {name: getattr(api, f"get{name}")(vehicle) for name in _KEPT if name not in of_type}
    changing = {name: _parameter(vehicle, f"laneChangeModel.{name}") for name in _LANE_CHANGING}
    api.setType(vehicle, kind)
    for name, value in kept.items():
        getattr(api, f"set{name}")(vehicle, value)
    for name, value in changing.items():
        if value:
            api.setParameter(vehicle, f"laneChangeModel.{name}", value)


def _parameter(vehicle: str, name: str) -> str:
    try:
        return libsumo.vehicle.getParameter(vehicle, name)
    except libsumo.TraCIException:  # a lane-change model without this parameter
        return ""
