"""What everything else speaks of: trajectories, scenes, interaction graphs, dynamics, the Policy protocol.

Begin with `graph` (who reacts to whom), `dynamics` (how vehicles move) and `policy` (what drives them). All of it is
pure: tensors in, tensors out.
"""
