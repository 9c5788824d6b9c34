"""Training one model from one configuration.

`train.train` trains the model by the objective that the configuration (`train.TrainConfig`) names, and returns it with
its reward; commands and `gri.paper` use these two. `fine_tuning` continues the training of a model on other scenes.
`optimisation` has the losses, batches and optimiser of all objectives. The objectives have rooms of their own:
`grounded` (this project's training), `adversarial` (the paper's) and `baselines`. Begin reading with `train`.
"""
