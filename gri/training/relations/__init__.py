"""Counterfactual teaching: the encoder learns who reacts to whom, on drawn scenes and on scenes broken on purpose.

`teach_encoder.teach_encoder` is the whole of it. Grounded training calls it where a configuration has `teaching`. Begin
with `teach_encoder`.
"""
