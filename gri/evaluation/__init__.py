"""How good is a model? Metrics of the paper, scores of graphs, tests out of distribution, and diagnostics.

`evaluate.evaluate` computes the metrics of one model on test scenes; `gri evaluate` and training use it. `metrics` has
the pure functions and their means with intervals, `graph_scores` more on graphs. `out_of_distribution`, `diagnostics`
and `recorded_scores` are for `gri.paper`, `true_relations` compares inferred graphs with a simulator's. Begin reading
with `evaluate`, then `metrics`.
"""
