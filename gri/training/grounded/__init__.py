"""Grounded training without an adversary: first the reward, then the graph, then the policy.

`train_grounded.train_grounded` trains on synthetic scenes, `recorded_traffic.train_recorded` on recorded ones,
`labelled_encoder.train_labelled_encoder` on scenes with known graphs; each has its settings. `constants_search` learns
constants of drivers that are wrong at first. `gri.training.adversarial` uses `planned_start` and
`gri.training.fine_tuning` uses `fit_encoder_and_policy`. Begin reading with `train_grounded`.
"""
