"""What perturbations change: traffic, starts, background vehicles, sensing and control.

Their types stand in `cosim.spec.perturbations`; `cosim.loop.perturbed_round` applies them to a round.
"""
