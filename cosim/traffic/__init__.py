"""The traffic of a simulation, from a scenario to a running SUMO.

`route_file` turns a traffic description into SUMO's route file and arguments. `replay` reads a recording and moves its
vehicles. `simulation_input` gathers everything that SUMO is started with, before anything runs. `running_simulation`
starts SUMO from it. Begin with `simulation_input.prepare_simulation`.
"""
