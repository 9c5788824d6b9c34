"""The neural networks: the encoder infers a graph, the decoder drives under it, `model` joins both.

Begin with `model.RelationalModel`; `rollout` drives scenes with it.
"""
