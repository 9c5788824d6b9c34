"""The neural networks: the encoder infers the graph, and the decoder (the policy) drives under it.

Begin with `model.RelationalModel`, which joins both. `rollout.rollout` drives scenes with a model, with gradients.
`decoder` defines the policy; `fast_decoder` is the form of it that the program runs. Other rooms use `model`,
`rollout`, `decoder.DecoderConfig` and `encoder.EncoderConfig`.
"""
