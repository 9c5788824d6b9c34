"""Counterfactual teaching: the encoder learns who reacts to whom, on drawn scenes and on scenes broken on purpose.

`teach_checkpoint.teach_model` gives a trained model a taught encoder; the command `gri teach` calls it.
`teach_encoder` has the scenes and the loss, `recorded_windows` those of recordings. `teach_merges` teaches merge models
the label-free posterior of merges. Begin with `teach_encoder`.
"""
