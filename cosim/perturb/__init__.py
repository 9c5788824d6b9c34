"""What perturbations change, as pure functions: traffic demand, starts, background vehicles, sensing and control.

The types of perturbations are in `cosim.spec.perturbations`. `cosim.loop.perturbed_round` plans what they do to a round
and `cosim.loop.intervention` carries it out. Begin with `displaced_starts`, the simplest kind.
"""
