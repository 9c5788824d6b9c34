"""Counterfactual teaching: the encoder learns who reacts to whom, on drawn scenes and on scenes broken on purpose.

`teach_checkpoint.teach_model` gives a trained model a taught encoder; the command `gri teach` calls it.
`teach_encoder` has the scenes and the loss. `teach_recorded` teaches recorded windows (`recorded_windows`) against
broken ones. `teach_merges` teaches merge models the label-free posterior of merges. Begin with `teach_encoder`.
"""
