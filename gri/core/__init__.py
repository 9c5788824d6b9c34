"""The concepts that all other rooms use: trajectories, scenes, interaction graphs, dynamics and the Policy protocol.

Begin with `graph` (which vehicle reacts to which), `dynamics` (how vehicles move) and `policy` (what drives them). All
functions are pure: tensors in, tensors out. `edges` needs no torch. `layers`, `scale` and `array_functions` are
building blocks of the networks.
"""
