"""Look at SUMO files of the user and propose a scenario for them.

`net_file` reads a net, `main_road` finds the road on which groups could be driven, and where lanes end.
`scenario_file` writes the scenario, `picture` draws the road. Begin reading in `propose`.
"""
