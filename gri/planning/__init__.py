"""Consequences of a reward: how likely recorded actions are under it, which graph they imply, which actions are best.

Likelihood of actions given a graph: `laplace_likelihood`, and `riccati_likelihood` for long horizons. Probability of
the edges given the actions: `edge_posterior`. Best actions of one vehicle: `best_response`, and `ilqr` for many
actions. Begin with `laplace_likelihood`. Training uses all of them but `best_response`; data uses `ilqr`, and
evaluation uses `best_response`.
"""
