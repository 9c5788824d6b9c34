"""How good a model is: the paper's metrics, scores of graphs, out-of-distribution tests, diagnostics.

Begin with `evaluate.evaluate`; `metrics` holds the pure functions that it averages.
"""
