"""An episode of a run in the formats of other tools: SUMO's FCD output, OpenSCENARIO, CommonRoad.

`moving_vehicles.vehicles_of` reads the vehicles of an episode from a run folder; `fcd`, `openscenario` and `commonroad`
write them; `net_lanes` has the lanes of the net, for the formats that want them. Begin with `moving_vehicles`.
"""
