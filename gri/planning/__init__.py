"""What follows from a reward: how likely recorded actions are under it, and which actions are best.

Begin with `laplace_likelihood`; `riccati_likelihood` does the same for long horizons, `ilqr` and `best_response` find
optima.
"""
